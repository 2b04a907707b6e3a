// What arrived, kept by the browser (Cache Storage), so that a page that is loaded again goes on from there. Browsers
// have it for pages from this machine and over HTTPS only.

import type { Arrived } from "./events.ts";
import { viewOf } from "./frames.ts";

const NAME = "splatwire-1",
  MOST_STREAMS = 8,
  WRITE_MS = 1000,
  HEAD = 0xffffffff;

/** What was kept of a stream. */
export interface Before {
  readonly head: Uint8Array;
  readonly packets: readonly Arrived[];
}

export class Kept {
  readonly #prefix: string;
  #parts = 0;
  #waiting: Arrived[] = [];
  #timer: ReturnType<typeof setTimeout> | null = null;
  #writing: Promise<void> = Promise.resolve();

  private constructor(
    readonly cache: Cache,
    file: string,
  ) {
    this.#prefix = `https://kept.invalid/${encodeURIComponent(file)}/`;
  }

  /** The store for a file; null where the browser has none, or lets this page have none. */
  static async open(file: string): Promise<Kept | null> {
    if (typeof caches === "undefined") return null;
    const cache = await caches.open(NAME).catch(() => null);
    return cache && new Kept(cache, file);
  }

  /** What is there; null without a head. */
  async read(): Promise<Before | null> {
    const packets: Arrived[] = [],
      mine = (await this.cache.keys()).filter(({ url }) => url.startsWith(this.#prefix));
    let head: Uint8Array | null = null;
    for (const key of mine) {
      const part = await this.cache.match(key);
      for (const one of recordsOf(new Uint8Array(part ? await part.arrayBuffer() : []))) {
        if (one.place === HEAD) head = one.bytes;
        else packets.push(one);
      }
      this.#parts = Math.max(this.#parts, 1 + Number(key.url.slice(this.#prefix.length)));
    }
    return head && { head, packets };
  }

  /** Begins anew with a stream: what was kept of another one is forgotten. */
  begin(head: Uint8Array): void {
    void this.clear();
    this.add([{ place: HEAD, bytes: head }]);
  }

  add(packets: readonly Arrived[]): void {
    for (const packet of packets) this.#waiting.push(packet);
    this.#timer ??= setTimeout(() => void this.flush(), WRITE_MS);
  }

  /** Writes what waits. A browser that has no room keeps nothing. */
  flush(): Promise<void> {
    if (this.#timer) clearTimeout(this.#timer);
    this.#timer = null;
    const bytes = partOf(this.#waiting.splice(0));
    if (bytes.length) {
      const key = `${this.#prefix}${this.#parts++}`;
      this.#writing = this.#writing.then(() => this.cache.put(key, new Response(bytes))).catch(() => undefined);
    }
    return this.#writing;
  }

  /** Forgets this stream. */
  clear(): Promise<void> {
    const before = this.#parts;
    this.#waiting = [];
    this.#writing = this.#writing
      .then(async () => {
        for (let n = 0; n < before; n++) await this.cache.delete(`${this.#prefix}${n}`);
      })
      .catch(() => undefined);
    return this.#writing;
  }

  /** Forgets the oldest streams beyond the most that are kept. */
  async tidy(): Promise<void> {
    const keys = await this.cache.keys(),
      folder = ({ url }: Request): string => url.slice(0, url.lastIndexOf("/") + 1),
      folders = [...new Set(keys.map(folder))].filter((name) => name !== this.#prefix);
    const old = new Set(folders.slice(0, Math.max(folders.length - MOST_STREAMS + 1, 0)));
    for (const key of keys) if (old.has(folder(key))) await this.cache.delete(key);
  }
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
