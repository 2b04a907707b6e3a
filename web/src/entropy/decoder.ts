// The range decoder. Its window has 48 bits, which a double holds exactly: no number here reaches 2^53.

const BOTTOM = 2 ** 40;
const FULL = 65536;

export class RangeDecoder {
  #code = 0;
  #span = 2 ** 48;
  #at: number;
  readonly #end: number;

  /** Behind the end zeros are read. */
  constructor(
    readonly data: Uint8Array,
    begin = 0,
    end = data.length,
  ) {
    this.#end = end;
    this.#at = begin + 6;
    for (let i = begin; i < begin + 6; i++) this.#code = this.#code * 256 + (i < end ? data[i] : 0);
  }

  /** Number below `total`, a power of two, that the code points at. */
  target(total: number): number {
    return Math.min(Math.floor(this.#code / Math.floor(this.#span / total)), total - 1);
  }

  /** Removes `[start, start + size)` out of `total`. */
  advance(start: number, size: number, total: number): void {
    const unit = Math.floor(this.#span / total);
    let span = unit * size;
    // Bytes that no encoder wrote may point beyond the last interval: the code stays within its span all the same.
    let code = Math.min(this.#code - unit * start, span - 1);
    while (span < BOTTOM) {
      code = code * 256 + (this.#at < this.#end ? this.data[this.#at] : 0);
      this.#at++;
      span *= 256;
    }
    this.#code = code;
    this.#span = span;
  }

  /** A bit under an adaptive model: `models[2 context]` and the next are two estimates of P(0) out of 2^16. */
  bit(models: Int32Array, context: number): number {
    const slow = models[2 * context],
      fast = models[2 * context + 1];
    const zero = Math.min(Math.max((slow + fast) >> 1, 32), FULL - 32);
    if (this.target(FULL) >= zero) {
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

  /** Equiprobable bits, at most 53. */
  raw(bits: number): number {
    let value = 0;
    while (bits > 0) {
      const some = Math.min(bits, 16),
        total = 1 << some,
        part = this.target(total);
      this.advance(part, 1, total);
      value = value * total + part;
      bits -= some;
    }
    return value;
  }

  /** A number below `count`, at most 2^16, all alike probable. */
  below(count: number): number {
    const value = Math.floor(((this.target(FULL) + 1) * count - 1) / FULL);
    const start = Math.floor((value * FULL) / count);
    this.advance(start, Math.floor(((value + 1) * FULL) / count) - start, FULL);
    return value;
  }

  /** A number from 0 on in Elias gamma, of at most 32 bits. */
  gamma(): number {
    let length = 0,
      value = 1;
    while (length < 32 && this.raw(1)) length++;
    for (; length > 0; length--) value = 2 * value + this.raw(1);
    return value - 1;
  }
}
