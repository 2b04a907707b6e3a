// Range decoder. Its state has 48 bits, so that all intermediate values are below 2^53 and exact as doubles.

const BOTTOM = 2 ** 40;
const FULL = 65536,
  /** Powers of two and their inverses: a product with an inverse is exact and faster than a quotient. */
  TOTALS = Float64Array.from({ length: 17 }, (_, bits) => 2 ** bits),
  INVERSES = TOTALS.map((total) => 1 / total);

export class RangeDecoder {
  #code = 0;
  #span = 2 ** 48;
  #at: number;
  readonly #end: number;

  /** Decodes `data` from `begin` to `end`. Bytes after `end` read as 0. */
  constructor(
    readonly data: Uint8Array,
    begin = 0,
    end = data.length,
  ) {
    this.#end = end;
    this.#at = begin + 6;
    for (let i = begin; i < begin + 6; i++) this.#code = this.#code * 256 + (i < end ? data[i] : 0);
  }

  /** Returns the position of the code, 0 to `total - 1`. `total` is a power of two. */
  target(total: number): number {
    return Math.min(Math.floor(this.#code / Math.floor(this.#span / total)), total - 1);
  }

  /** Consumes the interval `[start, start + size)` out of `total`. */
  advance(start: number, size: number, total: number): void {
    const unit = Math.floor(this.#span / total);
    this.#remove(unit * start, unit * size);
  }

  /** Consumes the part of the span from `start` on. */
  #remove(start: number, span: number): void {
    // Invalid bytes may point beyond the last interval. The clamp keeps the code within its span.
    let code = Math.min(this.#code - start, span - 1);
    while (span < BOTTOM) {
      code = code * 256 + (this.#at < this.#end ? this.data[this.#at] : 0);
      this.#at++;
      span *= 256;
    }
    this.#code = code;
    this.#span = span;
  }

  /**
   * Decodes a bit with an adaptive model. `models[2 context]` and the next entry are two estimates of P(0), out of
   * 2^16.
   */
  bit(models: Int32Array, context: number): number {
    const slow = models[2 * context],
      fast = models[2 * context + 1];
    const zero = Math.min(Math.max((slow + fast) >> 1, 32), FULL - 32);
    // equivalent to `target(FULL) >= zero`, without its division
    if (this.#code >= zero * Math.floor(this.#span / FULL)) {
      this.advance(zero, FULL - zero, FULL);
      models[2 * context] = slow - (slow >> 7);
      models[2 * context + 1] = fast - (fast >> 4);
      return 1;
    }
    this.advance(0, zero, FULL);
    models[2 * context] = slow + ((FULL - slow) >> 7);
    models[2 * context + 1] = fast + ((FULL - fast) >> 4);
    return 0;
  }

  /** Decodes up to 53 equiprobable bits. */
  raw(bits: number): number {
    let value = 0;
    while (bits > 0) {
      const some = Math.min(bits, 16),
        total = TOTALS[some],
        unit = Math.floor(this.#span * INVERSES[some]),
        part = Math.min(Math.floor(this.#code / unit), total - 1);
      this.#remove(unit * part, unit);
      value = value * total + part;
      bits -= some;
    }
    return value;
  }

  /** Decodes a uniformly distributed integer below `count`, which is at most 2^16. */
  below(count: number): number {
    const value = Math.floor(((this.target(FULL) + 1) * count - 1) / FULL);
    const start = Math.floor((value * FULL) / count);
    this.advance(start, Math.floor(((value + 1) * FULL) / count) - start, FULL);
    return value;
  }

  /** Decodes a non-negative integer in Elias gamma coding, at most 32 bits. */
  gamma(): number {
    let length = 0,
      value = 1;
    while (length < 32 && this.raw(1)) length++;
    for (; length > 0; length--) value = 2 * value + this.raw(1);
    return value - 1;
  }
}
