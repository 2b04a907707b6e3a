// What arrived, kept by the browser (Cache Storage), so that a page that is loaded again goes on from there. Browsers
// have it for pages from this machine and over HTTPS only.

import type { Arrived } from "./events.ts";
import { viewOf } from "./frames.ts";

/** The cache, whose name changes with the layout of its entries, and those of earlier layouts. */
const NAME = "splatwire-2";
const OLD_NAMES = ["splatwire-1"];
const MOST_STREAMS = 8;
/** Delay before packets are written, and longest wait for a browser's cache, milliseconds. */
const WRITE_MS = 1000;
const PATIENCE_MS = 3000;
const HEAD = 0xffffffff;

/** What was kept of a stream. */
export interface Before {
  readonly head: Uint8Array;
  readonly packets: readonly Arrived[];
}

export class Kept {
  readonly #prefix: string;
  /** Entries of two tabs have different names. */
  readonly #writer = crypto.randomUUID();
  #parts = 0;
  #waiting: Arrived[] = [];
  #timer: ReturnType<typeof setTimeout> | null = null;
  #writing: Promise<void> = Promise.resolve();
  /** True once the browser had no room: a later part is worth nothing without the earlier ones. */
  #full = false;

  private constructor(
    readonly cache: Cache,
    file: string,
  ) {
    this.#prefix = `https://kept.invalid/${encodeURIComponent(file)}/`;
  }

  /** The store for a file; null where the browser has none, or lets this page have none. */
  static async open(file: string): Promise<Kept | null> {
    if (typeof caches === "undefined") return null;
    for (const name of OLD_NAMES) void caches.delete(name).catch(() => undefined);
    const cache = await timely(caches.open(NAME)).catch(() => null);
    return cache && new Kept(cache, file);
  }

  /** Unverified records of the stream; null if they cannot be read, or have no head and are forgotten. */
  async read(): Promise<Before | null> {
    try {
      const before = await this.#read();
      if (!before) void this.clear();
      void this.#tidy().catch(() => undefined);
      return before;
    } catch {
      return null;
    }
  }

  async #read(): Promise<Before | null> {
    const packets: Arrived[] = [];
    let head: Uint8Array | null = null;
    for (const key of await timely(this.#keys())) {
      const part = await timely(this.cache.match(key)),
        bytes = part ? await timely(part.arrayBuffer()) : [];
      for (const one of recordsOf(new Uint8Array(bytes))) {
        if (one.place === HEAD) head = one.bytes;
        else packets.push(one);
      }
    }
    return head && { head, packets };
  }

  async #keys(): Promise<Request[]> {
    return (await this.cache.keys()).filter(({ url }) => url.startsWith(this.#prefix));
  }

  /** Starts again with a stream: records of an earlier one are deleted. */
  begin(head: Uint8Array): void {
    void this.clear();
    this.add([{ place: HEAD, bytes: head }]);
  }

  /** Takes verified packets. */
  add(packets: readonly Arrived[]): void {
    if (this.#full) return;
    for (const packet of packets) this.#waiting.push(packet);
    this.#timer ??= setTimeout(() => void this.flush(), WRITE_MS);
  }

  /**
   * Writes what waits; resolves when that is done or takes too long. A browser that has no room keeps what it has of
   * the stream, and nothing more.
   */
  flush(): Promise<void> {
    if (this.#timer) clearTimeout(this.#timer);
    this.#timer = null;
    const bytes = partOf(this.#waiting.splice(0));
    if (bytes.length) {
      const key = `${this.#prefix}${this.#writer}-${this.#parts++}`;
      this.#writing = this.#writing
        .then(() => (this.#full ? undefined : this.cache.put(key, new Response(bytes))))
        .then(
          () => undefined,
          () => void (this.#full = true),
        );
    }
    return timely(this.#writing).catch(() => undefined);
  }

  /** Forgets this stream. */
  clear(): Promise<void> {
    this.#waiting = [];
    this.#full = false;
    this.#writing = this.#writing
      .then(async () => {
        for (const key of await this.#keys()) await this.cache.delete(key);
      })
      .catch(() => undefined);
    return this.#writing;
  }

  /** Forgets the oldest streams beyond the most that are kept. */
  async #tidy(): Promise<void> {
    const keys = await this.cache.keys(),
      folder = ({ url }: Request): string => url.slice(0, url.lastIndexOf("/") + 1),
      folders = [...new Set(keys.map(folder))].filter((name) => name !== this.#prefix);
    const old = new Set(folders.slice(0, Math.max(folders.length - MOST_STREAMS + 1, 0)));
    for (const key of keys) if (old.has(folder(key))) await this.cache.delete(key);
  }
}

/** Result of a promise. Throws where it takes so long that a page is better off without. */
function timely<T>(work: Promise<T>): Promise<T> {
  let timer: ReturnType<typeof setTimeout>;
  const late = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(new Error("the browser's cache does not answer")), PATIENCE_MS);
  });
  return Promise.race([work, late]).finally(() => clearTimeout(timer));
}

/** Records: place, size, bytes. */
export function partOf(packets: readonly Arrived[]): Uint8Array<ArrayBuffer> {
  const bytes = new Uint8Array(packets.reduce((sum, packet) => sum + 8 + packet.bytes.length, 0)),
    numbers = viewOf(bytes);
  let at = 0;
  for (const packet of packets) {
    numbers.setUint32(at, packet.place, true);
    numbers.setUint32(at + 4, packet.bytes.length, true);
    bytes.set(packet.bytes, at + 8);
    at += 8 + packet.bytes.length;
  }
  return bytes;
}

/** The records of a part, as far as they are whole. */
export function recordsOf(bytes: Uint8Array): Arrived[] {
  const numbers = viewOf(bytes),
    found: Arrived[] = [];
  for (let at = 0; at + 8 <= bytes.length; ) {
    const end = at + 8 + numbers.getUint32(at + 4, true);
    if (end > bytes.length) break;
    found.push({ place: numbers.getUint32(at, true), bytes: bytes.slice(at + 8, end) });
    at = end;
  }
  return found;
}
