// A file on an HTTP server, read by range requests with timeouts and validation of responses.

import { delay } from "../scheduler.ts";
import { HttpError, Unreadable, withoutQuery } from "./http_error.ts";
import { permitted } from "./page_policy.ts";

export interface Limits {
  /** Initial idle timeout, milliseconds. Timeouts of slow servers raise it. */
  readonly idleMs: number;
  /** Size of a response from which a timeout is not due to a slow server and does not raise `idleMs`, bytes. */
  readonly fastBytes: number;
  /** Delay before damaged bytes are requested again, milliseconds. It grows by a factor of four. */
  readonly repeatMs: number;
  /** Size of the first request, bytes. It covers the coarsest tiles of a scene with levels. */
  readonly firstBytes: number;
  /** Size of later requests, bytes. A compromise between round trips and fast view changes. */
  readonly tilesBytes: number;
  /** Time after which a replacement of the file is no longer counted, milliseconds. */
  readonly changeMs: number;
}

const LIMITS: Limits = {
  idleMs: 8000,
  fastBytes: 4096,
  repeatMs: 250,
  firstBytes: 1 << 18,
  tilesBytes: 1 << 16,
  changeMs: 60_000,
};
/** Upper bound of the idle timeout, milliseconds. */
const MAX_IDLE_MS = 32_000;
/** Growth of the idle timeout after each timeout, for slow servers. */
const GROWTH = 1.5;
/** Number of consecutive useless range responses after which the whole file is requested. */
const MAX_USELESS = 3;
/** Number of consecutive failed range requests without progress after which the whole file is requested once. */
const MAX_FAILURES = 3;
/** Maximum number of requests for a range if responses are too short. Each may have half of the rest. */
const MAX_SHORT = 24;
/** Number of requests without a response after which it is checked if the browser withholds the responses. */
const MAX_WITHHELD = 3;
/** Maximum number of broken ranges that are kept. */
const MAX_BEGUN = 4;
/** Temporary error statuses, of a server that is busy or restarting. */
const PASSING = [408, 425, 429, 500];
/**
 * Query of a stream's URL on the servers of splatwire: the tag of its content. Proxies keep such a URL for a year, and
 * may keep a part of it from before the file was replaced.
 */
const CONTENT_TAG = /(\/(?:streams|private)\/[^?#]+)\?[0-9a-f]{16}(?=#|$)/;
const NO_HTTP = "its address does not begin with http:// or https://; `decode` takes the bytes of a file",
  NO_BLOB = "its blob was revoked, or belongs to another page";
const CONTENT_RANGE = /^bytes (\d+)-(\d+)\/(\d+|\*)$/;

/** Returns the URL of the current version of a file, which no proxy keeps: a stream's URL without the tag. */
export const uncachedUrl = (url: string): string => url.replace(CONTENT_TAG, "$1");

/** Error for incorrect range responses. The whole file must be read. */
export class RangeUnsupported extends Error {}

/** Error for a range after the end of the file. */
export class PastEnd extends Error {}

/** Error for a connection without data for longer than the idle timeout. */
export class Stalled extends Error {}

/** A response with the bytes of the file from `offset`. */
export interface Answer {
  readonly offset: number;
  /** True if it contains everything from `offset` to the end of the file. */
  readonly whole: boolean;
  /** Size of the file, bytes; null if unknown. */
  readonly total: number | null;
  /** True if the file has its final size and can be cached. */
  readonly keep: boolean;
  /** Returns the next bytes; null at the end. Throws if the connection breaks or times out. */
  read(): Promise<Uint8Array | null>;
  cancel(): void;
}

/** A file and what earlier requests revealed about its server. One object serves all attempts of a visit. */
export class HttpFile {
  /** Address for messages. */
  readonly name: string;
  /** Support for range requests. */
  ranges: "unknown" | "usable" | "unusable" = "unknown";
  /** True once the file was revalidated against the stored packets. */
  compared = false;
  /** Numbers of recent replacements of the file, damaged responses, and consecutive useless responses. */
  changes = 0;
  damages = 0;
  useless = 0;
  /** Number of times that the file's packets had another order than assumed. */
  reordered = 0;
  /** True if the file ended before its first packet, as one that is being copied to the server. */
  isCut = false;
  /** True if tiles are not where the stream's index has them. */
  isLinear = false;
  /** True once the server has delivered bytes of the file, and the number of refusals since the last progress. */
  hasAnswered = false;
  refusals = 0;
  /** True if the last answer was a web page, such as that of a login. */
  isWebPage = false;
  /** Number of damaged responses for each tile. */
  readonly damagedTiles = new Map<number, number>();
  /** Bytes of ranges that broke off or stalled, by their offset in the file. The next request continues them. */
  readonly #begun = new Map<number, Uint8Array>();
  /**
   * Number of bytes of broken ranges since a request for the whole file failed, too. These bytes are progress then. It
   * never decreases.
   */
  numBegun = 0;
  /** True while the whole file is requested because range requests failed repeatedly. */
  isTryingWhole = false;
  /** Time of the last replacement of the file. */
  changedAt = -Infinity;
  /** Aborts requests that have no signal of their own. */
  signal: AbortSignal | undefined;
  #failures = 0;
  #hasTriedWhole = false;
  #withheld = 0;
  /** Message of the last failed range request. */
  #reason = "";
  #idleMs: number;
  /** True once the server has answered with a part of the file. */
  #partial = false;

  constructor(
    readonly url: string,
    readonly limits = LIMITS,
  ) {
    this.name = withoutQuery(url);
    this.#idleMs = limits.idleMs;
  }

  /** Cache mode of requests. HTTP caches that returned damaged or outdated bytes are bypassed. */
  get cache(): RequestCache {
    return this.damages || this.changes ? "reload" : "default";
  }

  /**
   * Counts consecutive failed requests, because some servers answer only requests for the whole file. `isProgress` is
   * true if packets arrived before the failure, or `numBegun` grew.
   */
  noteFailure(error: Error, isProgress: boolean): void {
    if (isProgress) this.refusals = 0;
    if (this.isTryingWhole) {
      this.#hasTriedWhole = true;
      if (this.#reason && this.#reason !== error.message) error.message += `; for parts of it: ${this.#reason}`;
      this.isTryingWhole = isProgress;
      this.#failures = 0;
    } else {
      this.#failures = isProgress ? 0 : this.#failures + 1;
      this.#reason = error.message;
      this.isTryingWhole = this.#failures >= MAX_FAILURES;
    }
  }

  /** Keeps the bytes of a range that broke off; `known` of them came from `takeBegun`. */
  keepBegun(first: number, bytes: Uint8Array, known: number): void {
    if (this.ranges === "unusable" || !bytes.length) return;
    if (this.#hasTriedWhole) this.numBegun += bytes.length - known;
    this.#begun.delete(first);
    this.#begun.set(first, bytes);
    for (const oldest of this.#begun.keys()) if (this.#begun.size > MAX_BEGUN) this.#begun.delete(oldest);
  }

  hasBegun(first: number): boolean {
    return this.#begun.has(first);
  }

  /** Returns and forgets the bytes at `first` that an earlier request began to deliver, at most `maxBytes`. */
  takeBegun(first: number, maxBytes = Infinity): Uint8Array {
    const bytes = this.#begun.get(first) ?? new Uint8Array();
    this.#begun.delete(first);
    return bytes.subarray(0, maxBytes);
  }

  /** Counts replacements of the file. A page that is open for days may see many. */
  noteChange(): void {
    const now = performance.now();
    this.#begun.clear();
    this.changes = now - this.changedAt < this.limits.changeMs ? this.changes + 1 : 1;
    this.changedAt = now;
  }

  /** Counts useless range responses. Throws `RangeUnsupported` after `MAX_USELESS` in a row. */
  noteUseless(reason: string): void {
    if (this.ranges === "unknown" && ++this.useless >= MAX_USELESS) throw new RangeUnsupported(reason);
  }

  /**
   * Requests the bytes `first` to `end - 1`, where null means the end of the file. If `first` is null, the whole file
   * is requested without a range. Throws `HttpError`, `Stalled`, `PastEnd`, `RangeUnsupported`, `Unreadable`, or the
   * error of a broken connection, of the page's policy or of an address without a server.
   */
  async request(
    first: number | null,
    end: number | null = null,
    cache: RequestCache = this.cache,
    signal = this.signal,
  ): Promise<Answer> {
    const aborted = new AbortController(),
      cancel = (): void => {
        signal?.removeEventListener("abort", cancel);
        aborted.abort();
      };
    signal?.addEventListener("abort", cancel);
    if (signal?.aborted) cancel();
    const headers: Record<string, string> =
        first === null ? {} : { Range: `bytes=${first}-${end === null ? "" : end - 1}` },
      url = cache === "reload" || this.isTryingWhole ? uncachedUrl(this.url) : this.url;
    try {
      const response = await this.#timely(permitted(url, fetch(url, { headers, cache, signal: aborted.signal })));
      return this.#answer(response, first, end, cancel);
    } catch (error) {
      cancel();
      // Without a response, the server may have rejected the CORS preflight, which only range requests need.
      if (error instanceof TypeError && first !== null && this.ranges === "unknown" && !this.#partial)
        throw new RangeUnsupported(error.message);
      if (error instanceof TypeError && !/^https?:/.test(url)) {
        const reason = url.startsWith("blob:") ? NO_BLOB : NO_HTTP;
        throw Object.assign(new Error(`${this.name} cannot be requested: ${reason}`), { final: true });
      }
      if (
        error instanceof TypeError &&
        !this.hasAnswered &&
        ++this.#withheld >= MAX_WITHHELD &&
        (await this.#isWithheld())
      )
        throw new Unreadable(this.url);
      throw error;
    }
  }

  /** Returns true if the server responds, but the browser withholds its response from the page. */
  async #isWithheld(): Promise<boolean> {
    const signal = AbortSignal.timeout(this.#idleMs);
    try {
      return (await fetch(this.url, { method: "HEAD", mode: "no-cors", cache: "no-store", signal })).type === "opaque";
    } catch {
      return false;
    }
  }

  #answer(response: Response, first: number | null, end: number | null, cancel: () => void): Answer {
    const { status, headers, body } = response,
      encoded = !["", "identity"].includes(headers.get("content-encoding") ?? "");
    let offset = first ?? 0,
      whole = end === null,
      total: number | null = null,
      maxBytes = Infinity;
    if (status === 416 && offset > 0) throw new PastEnd(`${this.name} has no byte ${offset}`);
    if (first !== null && status >= 400 && status < 502 && !PASSING.includes(status) && !this.#isMissing(status))
      throw new RangeUnsupported(`${this.name} answers ${status} to a request for a part of it`);
    if (!response.ok || !body || status === 204) throw new HttpError(this.url, response);
    const type = headers.get("content-type") ?? "",
      range = CONTENT_RANGE.exec(headers.get("content-range") ?? ""),
      all = range?.[1] === "0" && Number(range[2]) + 1 === Number(range[3]);
    this.isWebPage = type.startsWith("text/html");
    if (first === null && status === 206 && range && range[3] !== "*" && !all)
      throw new Error(`${this.name} answers with a part of it`);
    if (first === null || status !== 206) {
      if (offset > 0) throw new RangeUnsupported(`${this.name} ignores the range of a request`);
      if (first !== null) this.ranges = "unusable";
      [offset, whole] = [0, true];
    } else {
      const fits =
        !headers.has("content-range") ||
        (range && Number(range[1]) === first && (end === null || Number(range[2]) < end));
      if (encoded || type.startsWith("multipart/") || (!fits && !(all && first === 0)))
        throw new RangeUnsupported(`${this.name} answers with another part than was requested`);
      this.#partial = true;
      if (range && range[3] !== "*") total = Number(range[3]);
      if (!fits) this.ranges = "unusable";
      if (total !== null) whole = Number(range![2]) + 1 === total;
      maxBytes = fits && end !== null ? end - first : Infinity;
    }
    this.hasAnswered = true;
    const reader = body.getReader(),
      keep = status === 206 || headers.has("content-length") || encoded;
    let count = 0;
    const read = async (): Promise<Uint8Array | null> => {
      const { value } = await this.#timely(reader.read(), count < this.limits.fastBytes).catch((error: unknown) => {
        cancel();
        // a content coding makes parts unreadable, and CORS hides its header
        if (error instanceof TypeError && first !== null && !count) this.noteUseless(error.message);
        throw error;
      });
      count += value?.length ?? 0;
      if (count > maxBytes) {
        cancel();
        throw new RangeUnsupported(`${this.name} answers with more than was requested`);
      }
      return value ?? null;
    };
    return { offset, whole, total, keep, read, cancel };
  }

  /** Returns true for the status of a removed file, which may be in the middle of its replacement. */
  #isMissing(status: number): boolean {
    return this.#partial && (status === 404 || status === 410);
  }

  /** Awaits a promise. Throws `Stalled` after the idle timeout, which then grows if the server is `slow`. */
  #timely<T>(work: Promise<T>, slow = true): Promise<T> {
    let timer: ReturnType<typeof setTimeout>;
    const idleMs = this.#idleMs,
      late = new Promise<never>((_, reject) => {
        timer = setTimeout(() => {
          if (slow) this.#idleMs = Math.max(idleMs, Math.min(GROWTH * idleMs, MAX_IDLE_MS));
          reject(new Stalled(`the server sent nothing for ${Math.round(idleMs / 1000)} s`));
        }, idleMs);
      });
    work.catch(() => undefined);
    return Promise.race([work, late]).finally(() => clearTimeout(timer));
  }

  /** Waits before damaged bytes are requested again, longer each time. */
  async wait(times: number): Promise<void> {
    await delay(this.limits.repeatMs * 4 ** (times - 1));
  }
}

/**
 * Requests the bytes `first` to `end - 1`, the rest again if a response is shorter or breaks off, and returns at least
 * `minBytes` bytes unless the server gives no more. Throws if a response stalls, or breaks off before its first byte;
 * the next call with the same `first` then continues.
 */
export async function readRange(
  file: HttpFile,
  first: number,
  end: number,
  minBytes: number,
  cache: RequestCache,
  signal?: AbortSignal,
): Promise<Uint8Array> {
  const bytes = new Uint8Array(end - first),
    { changedAt } = file,
    begun = file.takeBegun(first, bytes.length);
  bytes.set(begun);
  let count = begun.length;
  try {
    for (let tries = 0; tries < MAX_SHORT && count < minBytes; tries++) {
      const before = count,
        answer = await file.request(first + count, end, cache, signal);
      try {
        for (let piece = await answer.read(); piece; piece = count < bytes.length ? await answer.read() : null) {
          const needed = piece.subarray(0, bytes.length - count);
          bytes.set(needed, count);
          count += needed.length;
        }
      } catch (error) {
        // on a path that breaks every connection after some time, a whole range might never arrive
        if (!(error instanceof TypeError) || count === before) throw error;
      } finally {
        answer.cancel();
      }
      if (count === before) break;
    }
  } catch (error) {
    // an aborted request may end after the file was replaced
    if (!(error instanceof RangeUnsupported || error instanceof PastEnd) && file.changedAt === changedAt)
      file.keepBegun(first, bytes.subarray(0, count), begun.length);
    throw error;
  }
  return bytes.subarray(0, count);
}
