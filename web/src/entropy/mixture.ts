// Integers under a normal distribution or a mixture of two with a common mean. Interval bounds, out of 2^24, are
// computed on demand.

import type { RangeDecoder } from "./decoder.ts";
import { HALF_WIDTHS, INVERSE_SCALES, MEAN_BITS, NORMAL, TOTAL_BITS, Z_CELL_BITS, Z_LIMIT } from "./tables.ts";

const TOTAL = 2 ** TOTAL_BITS,
  ESCAPE_SIZE = 16;
const STEP = 2 ** MEAN_BITS,
  HALF_STEP = STEP / 2,
  CELL = 2 ** Z_CELL_BITS;

/** Uses after which all intervals of a window (at most `MAX_SYMBOLS`) are computed, and one more for 8 symbols. */
const USES = 16,
  MAX_SYMBOLS = 2048,
  GUESSES = 256,
  GUESS_SHIFT = TOTAL_BITS - 8;

/** Normal distribution function, out of 2^24, at a distance from the mean in steps (12 fractional bits). */
function normalCdf(distance: number, inverse: number): number {
  const z = Math.floor((distance * inverse) / 65536);
  if (z <= -Z_LIMIT) return 0;
  if (z >= Z_LIMIT) return TOTAL;
  const cell = (z + Z_LIMIT) >> Z_CELL_BITS,
    base = NORMAL[cell];
  return base + (((NORMAL[cell + 1] - base) * ((z + Z_LIMIT) & (CELL - 1))) >> Z_CELL_BITS);
}

export class Mixture {
  readonly #low: number;
  readonly #high: number;
  /** Cached lower bounds of the symbols' intervals, one per symbol of the window; -1 if not computed yet. */
  readonly #starts: Int32Array;
  /** Symbol that each `GUESS`-th position of the code is in. Null until it pays off to compute all intervals. */
  #guesses: Uint16Array | null = null;
  #uses = 0;

  /**
   * Creates a distribution. `mean` has 12 fractional bits; `scale` and `wide` index the scale table. `weight` is that
   * of the first component, out of 2^16; 65536 means a single normal.
   */
  constructor(
    readonly mean: number,
    readonly scale: number,
    readonly wide = 0,
    readonly weight = 65536,
  ) {
    const center = Math.floor((mean + HALF_STEP) / STEP);
    const width = weight < 65536 ? Math.max(HALF_WIDTHS[scale], HALF_WIDTHS[wide]) : HALF_WIDTHS[scale];
    this.#low = center - width;
    this.#high = center + width;
    if (this.#high - this.#low > 32767) [this.#low, this.#high] = [center - 16383, center + 16383];
    this.#starts = new Int32Array(this.#high - this.#low + 2).fill(-1);
  }

  decode(coder: RangeDecoder): number {
    const target = coder.target(TOTAL),
      most = this.#starts.length - 1;
    if (target >= TOTAL - ESCAPE_SIZE) {
      coder.advance(TOTAL - ESCAPE_SIZE, ESCAPE_SIZE, TOTAL);
      const above = coder.raw(1),
        excess = coder.gamma();
      return above ? this.#high + 1 + excess : this.#low - 1 - excess;
    }
    const guesses = this.#guesses;
    if (guesses) {
      const starts = this.#starts;
      let at = guesses[target >> GUESS_SHIFT],
        start = starts[at],
        next = starts[at + 1];
      while (next <= target) {
        at++;
        start = next;
        next = starts[at + 1];
      }
      coder.advance(start, next - start, TOTAL);
      return this.#low + at;
    }
    if (++this.#uses > USES + (most >> 3) && most <= MAX_SYMBOLS) this.#tabulate();
    let left = most >> 1,
      right = left + 1,
      jump = 1;
    if (target >= this.#start(left)) {
      while (target >= this.#start(right)) {
        left = right;
        jump *= 2;
        right = Math.min(right + jump, most);
      }
    } else {
      right = left;
      left = Math.max(left - 1, 0);
      while (target < this.#start(left)) {
        right = left;
        jump *= 2;
        left = Math.max(left - jump, 0);
      }
    }
    while (right - left > 1) {
      const middle = (left + right) >> 1;
      if (target >= this.#start(middle)) left = middle;
      else right = middle;
    }
    const start = this.#start(left);
    coder.advance(start, this.#start(right) - start, TOTAL);
    return this.#low + left;
  }

  /** Computes all intervals, and the first symbols of the searches for an interval. */
  #tabulate(): void {
    const guesses = new Uint16Array(GUESSES);
    for (let guess = 0, at = 0; guess < GUESSES; guess++) {
      while (at < this.#starts.length - 2 && this.#start(at + 1) <= guess << GUESS_SHIFT) at++;
      guesses[guess] = at;
    }
    for (let at = 0; at < this.#starts.length; at++) this.#start(at);
    this.#guesses = guesses;
  }

  #start(place: number): number {
    const known = this.#starts[place];
    return known >= 0 ? known : (this.#starts[place] = this.#compute(place));
  }

  #compute(place: number): number {
    const count = this.#starts.length - 1;
    if (place <= 0) return 0;
    if (place >= count) return TOTAL - ESCAPE_SIZE;
    const distance = (this.#low + place) * STEP - HALF_STEP - this.mean;
    let below = normalCdf(distance, INVERSE_SCALES[this.scale]);
    if (this.weight < 65536) {
      below = Math.floor(
        (below * this.weight + normalCdf(distance, INVERSE_SCALES[this.wide]) * (65536 - this.weight)) / 65536,
      );
    }
    return Math.floor((below * (TOTAL - ESCAPE_SIZE - count)) / TOTAL) + place;
  }
}

const ZERO_MEAN: (Mixture | undefined)[] = [];

/**
 * Returns the normal of mean 0 for an entry of the scale table. Instances are shared because each caches its bounds.
 */
export const zeroMeanNormal = (scale: number): Mixture => (ZERO_MEAN[scale] ??= new Mixture(0, scale));
