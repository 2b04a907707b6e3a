// Cache of received packets in the browser (Cache Storage), for later visits. Available only over HTTPS and on
// localhost.

import type { ReceivedPacket } from "./events.ts";
import { dataView } from "./wire_messages.ts";

/** Name of the cache, which changes with its entry layout, and names of earlier layouts. */
const NAME = "splatwire-3";
const OLD_NAMES = ["splatwire-1", "splatwire-2"];
const MAX_STREAMS = 8;
/** Delay before packets are written, and timeout of cache operations, milliseconds. */
const WRITE_MS = 1000;
const CACHE_TIMEOUT_MS = 3000;
/** Name, in place of an order, of the record that has the stream's head. */
export const HEAD = "head";
/** Bytes of a record before the name of its order: sizes of name and content, and the position. */
const RECORD_BYTES = 14;

/** Cached records of a stream. */
export interface CachedStream {
  readonly head: Uint8Array;
  readonly packets: readonly ReceivedPacket[];
}

export class PacketCache {
  readonly #prefix: string;
  /** Random part of entry names, so that two tabs write different entries. */
  readonly #writer = crypto.randomUUID();
  #parts = 0;
  #waiting: ReceivedPacket[] = [];
  #timer: ReturnType<typeof setTimeout> | null = null;
  #writing: Promise<void> = Promise.resolve();
  /** True once the browser had no space left. Later entries are useless without the earlier ones. */
  #full = false;

  private constructor(
    readonly cache: Cache,
    file: string,
  ) {
    this.#prefix = `https://kept.invalid/${encodeURIComponent(file)}/`;
  }

  /** Opens the cache of a file. Returns null without a server, or if the browser has none or denies access. */
  static async open(file: string): Promise<PacketCache | null> {
    if (typeof caches === "undefined" || !file.startsWith("http")) return null;
    for (const name of OLD_NAMES) void caches.delete(name).catch(() => undefined);
    const cache = await withTimeout(caches.open(NAME)).catch(() => null);
    return cache && new PacketCache(cache, file);
  }

  /** Returns the unverified records of the stream; null if they are unreadable or have no head. */
  async read(): Promise<CachedStream | null> {
    try {
      const before = await this.#read();
      if (!before) void this.clear();
      void this.#tidy().catch(() => undefined);
      return before;
    } catch {
      return null;
    }
  }

  async #read(): Promise<CachedStream | null> {
    const packets: ReceivedPacket[] = [];
    let head: Uint8Array | null = null;
    for (const key of await withTimeout(this.#keys())) {
      const part = await withTimeout(this.cache.match(key)),
        bytes = part ? await withTimeout(part.arrayBuffer()) : [];
      for (const one of recordsOf(new Uint8Array(bytes))) {
        if (one.order === HEAD) head = one.bytes;
        else packets.push(one);
      }
    }
    return head && { head, packets };
  }

  async #keys(): Promise<Request[]> {
    return (await this.cache.keys()).filter(({ url }) => url.startsWith(this.#prefix));
  }

  /** Starts again with a stream and deletes the records of earlier ones. */
  begin(head: Uint8Array): void {
    void this.clear();
    this.add([{ order: HEAD, position: 0, bytes: head }]);
  }

  /** Adds verified packets. */
  add(packets: readonly ReceivedPacket[]): void {
    if (this.#full) return;
    for (const packet of packets) this.#waiting.push(packet);
    this.#timer ??= setTimeout(() => void this.flush(), WRITE_MS);
  }

  /**
   * Writes the waiting packets. Resolves after the write or the timeout. After a failed write the cache stays as it is.
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
    return withTimeout(this.#writing).catch(() => undefined);
  }

  /** Deletes the records of this stream. */
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

  /** Deletes the oldest streams beyond the limit. */
  async #tidy(): Promise<void> {
    const keys = await this.cache.keys(),
      folder = ({ url }: Request): string => url.slice(0, url.lastIndexOf("/") + 1),
      folders = [...new Set(keys.map(folder))].filter((name) => name !== this.#prefix);
    const old = new Set(folders.slice(0, Math.max(folders.length - MAX_STREAMS + 1, 0)));
    for (const key of keys) if (old.has(folder(key))) await this.cache.delete(key);
  }
}

/** Awaits a promise. Throws after the timeout. */
function withTimeout<T>(work: Promise<T>): Promise<T> {
  let timer: ReturnType<typeof setTimeout>;
  const late = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(new Error("the browser's cache does not answer")), CACHE_TIMEOUT_MS);
  });
  return Promise.race([work, late]).finally(() => clearTimeout(timer));
}

/** Serialises records: size of the order's name (u16), size of the packet (u32), position (f64), name, packet. */
export function partOf(packets: readonly ReceivedPacket[]): Uint8Array<ArrayBuffer> {
  const names = packets.map(({ order }) => new TextEncoder().encode(order)),
    size = packets.reduce((sum, { bytes }, n) => sum + RECORD_BYTES + names[n].length + bytes.length, 0),
    all = new Uint8Array(size),
    numbers = dataView(all);
  let at = 0;
  for (const [n, { position, bytes }] of packets.entries()) {
    numbers.setUint16(at, names[n].length, true);
    numbers.setUint32(at + 2, bytes.length, true);
    numbers.setFloat64(at + 6, position, true);
    all.set(names[n], at + RECORD_BYTES);
    all.set(bytes, at + RECORD_BYTES + names[n].length);
    at += RECORD_BYTES + names[n].length + bytes.length;
  }
  return all;
}

/** Parses the complete records of a cache entry. */
export function recordsOf(bytes: Uint8Array): ReceivedPacket[] {
  const numbers = dataView(bytes),
    found: ReceivedPacket[] = [];
  for (let at = 0; at + RECORD_BYTES <= bytes.length; ) {
    const content = at + RECORD_BYTES + numbers.getUint16(at, true),
      end = content + numbers.getUint32(at + 2, true),
      position = numbers.getFloat64(at + 6, true);
    if (end > bytes.length) break;
    const order = new TextDecoder().decode(bytes.subarray(at + RECORD_BYTES, content));
    if (Number.isSafeInteger(position) && position >= 0)
      found.push({ order, position, bytes: bytes.slice(content, end) });
    at = end;
  }
  return found;
}
