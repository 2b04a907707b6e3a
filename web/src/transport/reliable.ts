// The reliable way: the stream as a file, over HTTP or out of the page itself; packets are taken as they come.

import { ContainerReader } from "../packets/container.ts";
import type { Listener } from "./events.ts";

const TELL_MS = 50;

/** Fetches a stream until its end; gives the words for how it ended. */
export async function receiveFile(url: string, listener: Listener): Promise<string> {
  const answer = await fetch(url);
  if (!answer.ok || !answer.body) throw new Error(`${url} answers ${answer.status} ${answer.statusText}`);
  return receiveStream(answer.body, "HTTP, in order and without loss", listener);
}

/** The same for bytes that are there already. */
export function receiveBytes(bytes: Uint8Array<ArrayBuffer>, listener: Listener): Promise<string> {
  return receiveStream(new Blob([bytes]).stream(), "in this file", listener);
}

async function receiveStream(body: ReadableStream<Uint8Array>, way: string, listener: Listener): Promise<string> {
  const reader = body.getReader(),
    container = new ContainerReader(),
    began = performance.now();
  let bytes = 0,
    packets = 0,
    told = false,
    toldAt = 0,
    waiting: Uint8Array[] = [];
  const tell = (): void => {
    if (container.head && !told) {
      told = true;
      listener.head(container.head);
    }
    if (waiting.length) listener.packets(waiting.splice(0));
    const expected = container.head?.manifest.numPackets ?? 0,
      seconds = (performance.now() - began) / 1000;
    listener.counts({ way, bytes, packets, expected, lost: 0, rejected: 0, seconds });
    toldAt = performance.now();
  };
  for (;;) {
    const { value, done } = await reader.read();
    if (done || container.broken || listener.stopped()) break;
    bytes += value.length;
    const found = container.feed(value);
    packets += found.length;
    waiting = waiting.concat(found);
    if (performance.now() - toldAt > TELL_MS) tell();
  }
  tell();
  if (!container.head) throw new Error("the file ends before its side information does");
  return container.broken
    ? "the rest of the file is damaged"
    : packets >= container.head.manifest.numPackets
      ? "complete"
      : "the file ends early";
}
