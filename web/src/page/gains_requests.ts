// Requests for gains, which conceal losses. Those for arriving packets leave most of the worker's time to decoding.

/** Minimum time before new gains are requested while packets arrive, milliseconds. */
const MIN_INTERVAL_MS = 1000;
/** Maximum of this time, milliseconds. */
const MAX_INTERVAL_MS = 20_000;
/** The time between these limits, in multiples of the time that the last gains took. */
const MULTIPLE = 4;

export class GainsRequests {
  #requested = 0;
  #answered = 0;
  /** Time of the last request, and the time that gains take, milliseconds. */
  #requestedAt = 0;
  #tookMs = 0;
  #timer: ReturnType<typeof setTimeout> | null = null;

  /** `request` requests gains, with a number from `next`. */
  constructor(readonly request: () => void) {}

  /** True if the last request is answered. */
  get settled(): boolean {
    return this.#answered === this.#requested;
  }

  /** Requests gains after a while, because packets arrived. */
  soon(): void {
    const ms = Math.min(Math.max(MIN_INTERVAL_MS, MULTIPLE * this.#tookMs), MAX_INTERVAL_MS);
    this.#timer ??= setTimeout(() => {
      this.#timer = null; // For clips, `request` does not call `next`, which would clear the timer.
      this.request();
    }, ms);
  }

  /**
   * Returns the number of a new request, which replaces earlier ones. An unanswered one took at least until now:
   * otherwise no request would live long enough for an answer in a large scene.
   */
  next(): number {
    clearTimeout(this.#timer!);
    this.#timer = null;
    const now = performance.now();
    if (!this.settled) this.#tookMs = Math.max(this.#tookMs, now - this.#requestedAt);
    this.#requestedAt = now;
    return ++this.#requested;
  }

  /** Notes an answer of the worker. Returns false for one to an earlier request, which is ignored. */
  onAnswer(number: number): boolean {
    if (number !== this.#requested) return false;
    this.#answered = number;
    this.#tookMs = performance.now() - this.#requestedAt;
    return true;
  }

  /** Replaces earlier requests by none, because nothing is missing. */
  skip(): void {
    this.#answered = this.next();
  }
}
