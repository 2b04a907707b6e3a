// Fake server, browser cache and page. Each test decides every answer.

import assert from "node:assert/strict";
import type { TestContext } from "node:test";

import type { Camera } from "../src/model/camera.ts";
import { ContainerReader, fileHead } from "../src/packets/container.ts";
import { crc32 } from "../src/packets/crc32.ts";
import { type Fields, parseJson, writeJson } from "../src/packets/json.ts";
import { sha256 } from "../src/sha256.ts";
import type { ReceivedPacket } from "../src/transport/events.ts";
import { receiveAll, type Source, type Transports } from "../src/transport/failover.ts";
import { HttpFile } from "../src/transport/http_file.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { recordsOf } from "../src/transport/packet_cache.ts";
import { dataView } from "../src/transport/wire_messages.ts";
import { WorkerReceiver } from "../src/worker_receiver.ts";

export const URL_ = "https://scenes.example/a.swz";
/** Small limits, so that even the smallest streams arrive in several parts. */
export const LIMITS = {
  idleMs: 200,
  fastBytes: 100,
  repeatMs: 1,
  firstBytes: 4000,
  tilesBytes: 2000,
  changeMs: 60_000,
};
const CLOCK_STEP_MS = 50;
/** Camera so close that every tile of a scene with levels is selected. */
const NEAR: Camera = {
  viewmat: [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 3],
    [0, 0, 0, 1],
  ],
  focal: 1e6,
  width: 4e6,
  height: 4e6,
  margin: 0,
};

/** Bounds of a requested range, the second exclusive; null for the whole file. */
export type Range = readonly [number, number] | null;

export interface Asked {
  readonly url: string;
  readonly range: Range;
  readonly cache: RequestCache;
  readonly signal: AbortSignal;
}

/** Returns the answer to a request. `n` counts requests from 0. */
export type Answering = (asked: Asked, n: number) => Response | Promise<Response>;

/** Fake server that records its requests. */
export class Server {
  readonly asked: Asked[] = [];

  constructor(public answering: Answering) {
    globalThis.fetch = async (url, init) => {
      const header = (init?.headers as Record<string, string> | undefined)?.["Range"],
        bounds = /^bytes=(\d+)-(\d*)$/.exec(header ?? ""),
        range = bounds ? ([Number(bounds[1]), bounds[2] ? Number(bounds[2]) + 1 : Infinity] as const) : null,
        asked = { url: String(url), range, cache: init?.cache ?? "default", signal: init!.signal! };
      this.asked.push(asked);
      const answer = this.answering(asked, this.asked.length - 1);
      return Promise.race([answer, aborted(asked.signal)]);
    };
  }

  /** Returns the bytes of all requests. A whole file counts with its size. */
  bytes(size: number): number {
    return this.asked.reduce((sum, { range }) => sum + (range ? Math.min(range[1], size) - range[0] : size), 0);
  }
}

function aborted(signal: AbortSignal): Promise<never> {
  return new Promise((_, reject) =>
    signal.addEventListener("abort", () => reject(new DOMException("aborted", "AbortError"))),
  );
}

/** Replaces `setTimeout` by a clock that only `advance` moves, until the end of a test. */
export function stopClock({ mock }: TestContext): { advance(ms: number, signal?: AbortSignal): Promise<void> } {
  mock.timers.enable({ apis: ["setTimeout"] });
  const advance = async (ms: number, signal?: AbortSignal): Promise<void> => {
    for (let passed = 0; passed < ms && !signal?.aborted; passed += CLOCK_STEP_MS) {
      await new Promise((resolve) => setImmediate(resolve)); // what was due has its effect
      mock.timers.tick(CLOCK_STEP_MS);
    }
  };
  return { advance };
}

/** Answers as a correct file server does. */
export function part(file: Uint8Array, { range }: Asked, headers: Record<string, string> = {}): Response {
  if (!range) return whole(file, headers);
  const [first, end] = [range[0], Math.min(range[1], file.length)];
  if (first >= file.length) return new Response(null, { status: 416 });
  const said = { "Content-Range": `bytes ${first}-${end - 1}/${file.length}`, ...headers };
  return new Response(file.slice(first, end), { status: 206, headers: said });
}

/** Answers every request with the whole file, in pieces. */
export function whole(file: Uint8Array, headers: Record<string, string> = {}, piece = 700): Response {
  const pieces = Array.from({ length: Math.ceil(file.length / piece) }, (_, n) =>
    file.slice(n * piece, (n + 1) * piece),
  );
  const body = new ReadableStream<Uint8Array>({
    pull: (controller) => {
      const next = pieces.shift();
      if (next) controller.enqueue(next);
      else controller.close();
    },
  });
  return new Response(body, { headers: { "Content-Length": String(file.length), ...headers } });
}

/** Returns an answer whose body has some bytes and then breaks or hangs. */
export function begun(bytes: Uint8Array, init: ResponseInit, ends: "breaks" | "hangs"): Response {
  let sent = false;
  const body = new ReadableStream<Uint8Array>({
    pull: (controller) => {
      if (!sent && bytes.length) controller.enqueue(bytes);
      else if (ends === "breaks") controller.error(new TypeError("network error"));
      else return new Promise<void>(() => undefined);
      sent = true;
      return undefined;
    },
  });
  return new Response(body, init);
}

/** Returns the file with one bit flipped. */
export function flipped(file: Uint8Array, at: number): Uint8Array {
  const damaged = file.slice();
  damaged[at] ^= 16;
  return damaged;
}

/** Returns the offsets of the packets in a file, after their size fields. */
export function packetOffsets(file: Uint8Array): number[] {
  const container = new ContainerReader(),
    packets = container.feed(file);
  let at = container.headBytes.length;
  return packets.map((packet) => {
    at += 4 + packet.length;
    return at - packet.length;
  });
}

/** Returns the same scene as another stream: its id, and therefore every packet, differs. */
export function otherStream(file: Uint8Array): Uint8Array {
  const container = new ContainerReader(),
    packets = container.feed(file),
    size = dataView(file).getUint32(5, true),
    fields = parseJson(new TextDecoder().decode(file.subarray(9, 9 + size))) as Fields;
  fields.set("stream_id", "0badcafe");
  fields.delete("digest");
  fields.set("digest", sha256(new TextEncoder().encode(writeJson(fields))).slice(0, 16));
  const sorted = new Map([...fields].sort(([a], [b]) => (a < b ? -1 : 1))),
    parts = [fileHead(new TextEncoder().encode(writeJson(sorted)), container.head!.sideInfo)];
  for (const packet of packets) {
    const numbers = dataView(packet);
    numbers.setUint32(1, 0x0badcafe, true);
    numbers.setUint32(12, crc32(packet.subarray(16), crc32(packet.subarray(0, 12))), true);
    const prefix = new Uint8Array(4);
    dataView(prefix).setUint32(0, packet.length, true);
    parts.push(prefix, packet);
  }
  return new Uint8Array(Buffer.concat(parts));
}

/** Cache Storage in memory. */
export class Caches {
  readonly entries = new Map<string, Uint8Array<ArrayBuffer>>();
  /** Number of entries above which the browser has no more space. */
  room = Infinity;

  async open(): Promise<Cache> {
    const { entries } = this,
      nameOf = (key: RequestInfo | URL): string => (typeof key === "string" ? key : (key as Request).url);
    const cache = {
      keys: async () => [...entries.keys()].map((url) => ({ url })),
      match: async (key: Request) => (entries.has(nameOf(key)) ? new Response(entries.get(nameOf(key))) : undefined),
      put: async (key: string, answer: Response) => {
        if (entries.size >= this.room) throw new DOMException("no room", "QuotaExceededError");
        entries.set(key, new Uint8Array(await answer.arrayBuffer()));
      },
      delete: async (key: Request) => entries.delete(nameOf(key)),
    };
    return cache as unknown as Cache;
  }

  async delete(): Promise<boolean> {
    return false;
  }

  /** Everything that is kept, entry by entry. */
  get records(): ReceivedPacket[] {
    return [...this.entries.values()].flatMap((bytes) => recordsOf(bytes));
  }
}

/** Result of a visit, and the messages of its worker. */
export interface Visit {
  /** Description of how the visit ended, or an error message. */
  readonly text: string;
  readonly complete: boolean;
  /** True if all decoded integers equal the encoded ones. */
  readonly verified: boolean;
  readonly said: readonly FromWorker[];
  readonly lost: readonly string[];
  readonly reception: WorkerReceiver;
}

/** Visits a page with a stream, as its worker does. Waits between attempts end at once. */
export async function visit(
  caches: Caches | null = null,
  source: Partial<Source> = {},
  ways: Partial<Transports> = {},
): Promise<Visit> {
  const said: FromWorker[] = [],
    world = globalThis as Record<string, unknown>;
  world["caches"] = caches ?? undefined;
  const reception = new WorkerReceiver();
  let looks = 0;
  world["self"] = {
    postMessage: (message: FromWorker): void => {
      said.push(message);
      if (message.kind === "info" && message.info.viewDependent)
        setImmediate(() => reception.setView({ kind: "view", camera: NEAR, budget: 1_000_000, requestId: ++looks }));
    },
  };
  const from = { session: null, name: "a", file: URL_, ...source },
    all: Transports = {
      receiveDatagrams: () => assert.fail("a session was begun"),
      lookUpSession: async () => null,
      wait: async () => undefined,
      openFile: (url) => new HttpFile(url, LIMITS),
      ...ways,
    };
  let text: string;
  try {
    await reception.resume(from.file);
    text = await receiveAll(from, reception, all);
    await reception.settled();
  } catch (error) {
    text = (error as Error).message;
    await reception.settled();
  }
  await reception.digest();
  const verified = said.some((one) => one.kind === "digest" && one.isVerified),
    lost = said.flatMap((one) => (one.kind === "disconnect" ? [one.reason] : []));
  await reception.cache?.flush();
  return { text, complete: text === "complete" && reception.complete, verified, said, lost, reception };
}
