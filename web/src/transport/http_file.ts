// A file on an HTTP server: requests for parts of it, with limits for silence and checks of each answer.

import { pause } from "../turns.ts";
import { Refused } from "./refused.ts";

export interface Limits {
  /** Longest silence of a connection at first, milliseconds; each one that is silent for longer raises it. */
  readonly idleMs: number;
  /** Wait before damaged bytes are requested again, milliseconds; four times as long the next time. */
  readonly repeatMs: number;
  /**
   * Bytes of the first request. Of a scene with levels they hold the coarsest ones; its view then requests what it
   * needs.
   */
  readonly firstBytes: number;
  /** Bytes of later requests: enough that the way there and back costs little, and a view that turns is soon served. */
  readonly tilesBytes: number;
}

const LIMITS: Limits = { idleMs: 8000, repeatMs: 250, firstBytes: 1 << 18, tilesBytes: 1 << 16 };
/** Longest silence of a connection however often others were silent, milliseconds. */
const MAX_IDLE_MS = 32_000;
/** Factor of the limit for silence after a connection that was silent for longer: some servers are slow. */
const GROWTH = 1.5;
/** Parts in a row that bring nothing, after which the whole file is requested. */
const MAX_USELESS = 3;
/** Error statuses that say the same about the whole file as about a part of it. */
const ABOUT_THE_FILE = [401, 404, 408, 410, 425, 429];
const CONTENT_RANGE = /^bytes (\d+)-(\d+)\/(\d+|\*)$/;

/** The server does not answer requests for parts of a file correctly: the whole file has to be read. */
export class RangeUnsupported extends Error {}

/** A requested part begins behind the end of the file. */
export class PastEnd extends Error {}

/** No byte came for longer than the limit. */
export class Stalled extends Error {}

/** An answer whose bytes begin at `offset` in the file. */
export interface Answer {
  readonly offset: number;
  /** True if it has everything from `offset` to the end of the file. */
  readonly whole: boolean;
  /** Size of the file, bytes; null if it is unknown. */
  readonly total: number | null;
  /** True if the file has its final size, so that it can be kept. */
  readonly keep: boolean;
  /** Next bytes; null at the end. Throws where the connection breaks or falls silent. */
  read(): Promise<Uint8Array | null>;
  cancel(): void;
}

/** What is known of the server after some requests. One object serves all attempts of a visit. */
export class HttpFile {
  /** Answers to requests for parts of the file: not known yet, correct, or not. */
  ranges: "unknown" | "usable" | "unusable" = "unknown";
  /** True once the file was compared with the packets that are held. */
  compared = false;
  /** How often the file became another one, its bytes were damaged, and parts of it were useless in a row. */
  changes = 0;
  damages = 0;
  useless = 0;
  /** True once the server has given bytes of the file, and how often it refused it later. */
  given = false;
  refusals = 0;
  /** How often each tile came damaged. */
  readonly damagedTiles = new Map<number, number>();
  #idleMs: number;
  /** True once the server has answered with a part of the file. */
  #partial = false;

  constructor(
    readonly url: string,
    readonly limits = LIMITS,
  ) {
    this.#idleMs = limits.idleMs;
  }

  /** Cache mode of requests: caches that have given damaged or outdated bytes are passed by. */
  get cache(): RequestCache {
    return this.damages || this.changes ? "reload" : "default";
  }

  /** Counts parts of the file that were of no use. Throws `RangeUnsupported` where there are too many in a row. */
  noteUseless(reason: string): void {
    if (this.ranges === "unknown" && ++this.useless >= MAX_USELESS) throw new RangeUnsupported(reason);
  }

  /**
   * Requests bytes `first` to `end` (exclusive; null for the end of the file). Without a first byte the whole file is
   * requested. Throws `Refused`, `Stalled`, `PastEnd`, `RangeUnsupported`, or the error of a broken connection.
   */
  async request(
    first: number | null,
    end: number | null = null,
    cache: RequestCache = this.cache,
    signal?: AbortSignal,
  ): Promise<Answer> {
    const aborted = new AbortController(),
      cancel = (): void => aborted.abort();
    signal?.addEventListener("abort", cancel);
    if (signal?.aborted) cancel();
    const headers: Record<string, string> =
      first === null ? {} : { Range: `bytes=${first}-${end === null ? "" : end - 1}` };
    try {
      const response = await this.#timely(fetch(this.url, { headers, cache, signal: aborted.signal }));
      return this.#answer(response, first, end, cancel);
    } catch (error) {
      cancel();
      // Without an answer, a preflight may have been refused: it is sent for parts of a file only.
      if (error instanceof TypeError && first !== null && this.ranges === "unknown" && !this.#partial)
        throw new RangeUnsupported(error.message);
      throw error;
    }
  }

  #answer(response: Response, first: number | null, end: number | null, cancel: () => void): Answer {
    const { status, headers, body } = response,
      encoded = !["", "identity"].includes(headers.get("content-encoding") ?? "");
    let offset = first ?? 0,
      whole = end === null,
      total: number | null = null,
      most = Infinity;
    if (status === 416 && offset > 0) throw new PastEnd(`${this.url} has no byte ${offset}`);
    if (first !== null && status >= 400 && status < 502 && status !== 500 && !ABOUT_THE_FILE.includes(status))
      throw new RangeUnsupported(`${this.url} answers ${status} to a request for a part of it`);
    if (!response.ok || !body || status === 204) throw new Refused(this.url, response);
    if (first === null || status !== 206) {
      if (offset > 0) throw new RangeUnsupported(`${this.url} ignores the range of a request`);
      if (first !== null) this.ranges = "unusable";
      [offset, whole] = [0, true];
    } else {
      const said = headers.get("content-range"),
        range = CONTENT_RANGE.exec(said ?? ""),
        all = range?.[1] === "0" && Number(range[2]) + 1 === Number(range[3]),
        fits = !said || (range && Number(range[1]) === first && (end === null || Number(range[2]) < end));
      if (encoded || (headers.get("content-type") ?? "").startsWith("multipart/") || (!fits && !(all && first === 0)))
        throw new RangeUnsupported(`${this.url} answers with another part than was requested`);
      this.#partial = true;
      if (range && range[3] !== "*") total = Number(range[3]);
      if (!fits) this.ranges = "unusable";
      if (total !== null) whole = Number(range![2]) + 1 === total;
      most = fits && end !== null ? end - first : Infinity;
    }
    this.given = true;
    const reader = body.getReader(),
      keep = status === 206 || headers.has("content-length") || encoded;
    let count = 0;
    const read = async (): Promise<Uint8Array | null> => {
      const { value } = await this.#timely(reader.read()).catch((error: unknown) => {
        cancel();
        // a content coding makes parts unreadable, and pages of other sites are not told of it
        if (error instanceof TypeError && first !== null) this.noteUseless(error.message);
        throw error;
      });
      count += value?.length ?? 0;
      if (count > most) {
        cancel();
        throw new RangeUnsupported(`${this.url} answers with more than was requested`);
      }
      return value ?? null;
    };
    return { offset, whole, total, keep, read, cancel };
  }

  /** Result of a promise. Throws `Stalled` if that takes longer than the limit, which then grows. */
  #timely<T>(work: Promise<T>): Promise<T> {
    let timer: ReturnType<typeof setTimeout>;
    const idleMs = this.#idleMs,
      late = new Promise<never>((_, reject) => {
        timer = setTimeout(() => {
          this.#idleMs = Math.max(idleMs, Math.min(GROWTH * idleMs, MAX_IDLE_MS));
          reject(new Stalled(`the server sent nothing for ${Math.round(idleMs / 1000)} s`));
        }, idleMs);
      });
    work.catch(() => undefined);
    return Promise.race([work, late]).finally(() => clearTimeout(timer));
  }

  /** Waits before bytes that were damaged are requested again, longer each time. */
  async wait(times: number): Promise<void> {
    await pause(this.limits.repeatMs * 4 ** (times - 1));
  }
}

/** All bytes of an answer, at most `size`. */
export async function readBytes(answer: Answer, size: number): Promise<Uint8Array> {
  const bytes = new Uint8Array(size);
  let count = 0;
  for (let piece = await answer.read(); piece; piece = count < size ? await answer.read() : null) {
    const some = piece.subarray(0, size - count);
    bytes.set(some, count);
    count += some.length;
  }
  return bytes.subarray(0, count);
}
