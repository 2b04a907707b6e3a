// The reliable way: the stream as a file, over HTTP or out of the page itself; packets are taken as they come.

import { ContainerReader, type Head } from "../packets/container.ts";
import type { Arrived, Listener } from "./events.ts";
import type { Held, Rest } from "./held.ts";
import { Refused } from "./refused.ts";
import { NoRanges, receiveTiles } from "./tiles.ts";

const PIECE = 1 << 16,
  TELL_MS = 50,
  SILENCE_MS = 20_000;
const WAY = "HTTP, in order and without loss";
/** Bytes that come in order of a scene with levels, the coarsest first, before its view asks for what it wants. */
const FIRST = 1 << 18,
  FIRST_CAME = "the first of it came";

/** The file is another one than that of which a part is there. */
class Changed extends Error {}

interface From {
  readonly way: string;
  readonly keep: boolean;
  readonly head: Head | null;
  readonly rest: Rest | null;
  /** So many bytes are enough of a scene with levels; all where absent. */
  readonly enough?: number;
}

/**
 * Fetches what is lacking of a stream's file; gives the words for how it ended. Throws where the connection breaks, the
 * server refuses, or the file is no stream.
 */
export async function receiveFile(url: string, listener: Listener, held: Held, head: Head | null): Promise<string> {
  const { rest } = held,
    { fetching } = listener;
  if (fetching) {
    try {
      return await receiveTiles(url, listener, held.headBytes, fetching);
    } catch (error) {
      if (!(error instanceof NoRanges)) throw error;
    }
  }
  if (rest && head) {
    const aborted = new AbortController(),
      headers = { Range: `bytes=${rest.offset - rest.tail.length}-` };
    const answer = await fetch(url, { headers, cache: "no-store", signal: aborted.signal });
    try {
      if (answer.status === 206)
        return await receiveStream(answer, aborted, listener, { way: WAY, keep: true, head, rest });
      if (answer.status !== 416 && !answer.ok) throw new Refused(url, answer);
      if (answer.ok) return await receiveStream(answer, aborted, listener, whole(answer));
    } catch (error) {
      if (!(error instanceof Changed)) throw error;
    } finally {
      aborted.abort();
    }
    held.clear();
  }
  const aborted = new AbortController(),
    answer = await fetch(url, { cache: "no-store", signal: aborted.signal }); // it may be cut: what came is kept here
  if (!answer.ok || !answer.body) throw new Refused(url, answer);
  const ended = await receiveStream(answer, aborted, listener, {
    ...whole(answer),
    enough: fetching ? Infinity : FIRST,
  });
  if (ended !== FIRST_CAME) return ended;
  aborted.abort();
  return receiveFile(url, listener, held, head);
}

/** Of a file that still grows, which has no length yet, nothing is kept. */
const whole = ({ headers }: Response): From => ({
  way: WAY,
  keep: headers.has("content-length") || headers.has("content-encoding"),
  head: null,
  rest: null,
});

/** The same for bytes that are there already. */
export function receiveBytes(bytes: Uint8Array<ArrayBuffer>, listener: Listener): Promise<string> {
  const from = { way: "in this file", keep: false, head: null, rest: null };
  return receiveStream(new Response(bytes), new AbortController(), listener, from);
}

async function receiveStream(
  answer: Response,
  aborted: AbortController,
  listener: Listener,
  from: From,
): Promise<string> {
  const { way, keep, head, rest, enough = Infinity } = from,
    reader = answer.body!.getReader(),
    container = new ContainerReader(head),
    began = performance.now();
  let bytes = 0,
    place = rest?.place ?? 0,
    told = head !== null,
    toldAt = 0,
    waiting: Arrived[] = [],
    tail = rest?.tail ?? new Uint8Array(),
    unread = new Uint8Array();
  let timer: ReturnType<typeof setTimeout> | undefined;
  const tell = (): void => {
    clearTimeout(timer);
    timer = undefined;
    if (container.head && !told) {
      told = true;
      listener.head(container.head, container.headBytes, keep);
    }
    if (waiting.length) listener.packets(waiting.splice(0));
    const expected = container.head?.manifest.numPackets ?? 0,
      seconds = (performance.now() - began) / 1000;
    listener.counts({ way, bytes, packets: place, expected, lost: 0, rejected: 0, seconds });
    toldAt = performance.now();
  };
  for (;;) {
    const value = unread.length
      ? unread
      : await timely(reader.read(), aborted).then(
          ({ value }) => value,
          (error: unknown) => {
            tell(); // what came before it broke is there
            throw error;
          },
        );
    if (!value || container.broken || listener.stopped()) break;
    const piece = value.subarray(0, PIECE), // a browser hands over all that waited for a busy thread
      again = Math.min(tail.length, piece.length);
    unread = value.subarray(PIECE);
    bytes += piece.length;
    for (let n = 0; n < again; n++) if (piece[n] !== tail[n]) throw new Changed();
    tail = tail.subarray(again);
    const found = container.feed(piece.subarray(again)).map((packet, n) => ({ place: place + n, bytes: packet }));
    place += found.length;
    waiting = waiting.concat(found);
    if ((container.head && !told) || performance.now() - toldAt > TELL_MS) tell();
    if (bytes >= enough && listener.fetching) {
      tell();
      return FIRST_CAME;
    } else timer ??= setTimeout(tell, TELL_MS);
  }
  clearTimeout(timer);
  if (tail.length) throw new Changed(); // it ends before what is there already
  tell();
  if (!container.head) throw new Error("the file ends before its side information does");
  if (container.broken) return "the rest of the file is damaged";
  return place >= container.head.manifest.numPackets ? "complete" : "the file ends early";
}

/** What a promise comes to, unless that takes too long: a connection that broke somewhere far away does not say so. */
function timely<T>(work: Promise<T>, aborted: AbortController): Promise<T> {
  let timer: ReturnType<typeof setTimeout>;
  const late = new Promise<never>((_, reject) => {
    timer = setTimeout(() => {
      reject(new Error("the server fell silent"));
      aborted.abort();
    }, SILENCE_MS);
  });
  return Promise.race([work, late]).finally(() => clearTimeout(timer));
}
