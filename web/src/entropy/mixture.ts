// Integers under a normal or a mixture of two of one mean: intervals out of 2^24 are computed where a symbol is looked
// for.

import type { RangeDecoder } from "./decoder.ts";
import { HALF_WIDTHS, INVERSE_SCALES, MEAN_BITS, NORMAL, TOTAL_BITS, Z_CELL_BITS, Z_LIMIT } from "./tables.ts";

const TOTAL = 2 ** TOTAL_BITS,
  ESCAPE = 16;
const STEP = 2 ** MEAN_BITS,
  HALF_STEP = STEP / 2,
  CELL = 2 ** Z_CELL_BITS;

/** Distribution function, out of 2^24, at a distance from the mean (in steps, 12 fractional bits). */
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
  /** Starts of intervals that were asked for before, -1 where none was; of all symbols of the window. */
  readonly #starts: Int32Array;

  /**
   * `mean` has 12 fractional bits, scales are entries of the table; `weight` of the first out of 2^16 (all: no second).
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
    if (target >= TOTAL - ESCAPE) {
      coder.advance(TOTAL - ESCAPE, ESCAPE, TOTAL);
      const above = coder.raw(1),
        excess = coder.gamma();
      return above ? this.#high + 1 + excess : this.#low - 1 - excess;
    }
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

  #start(place: number): number {
    const known = this.#starts[place];
    return known >= 0 ? known : (this.#starts[place] = this.#compute(place));
  }

  #compute(place: number): number {
    const count = this.#starts.length - 1;
    if (place <= 0) return 0;
    if (place >= count) return TOTAL - ESCAPE;
    const distance = (this.#low + place) * STEP - HALF_STEP - this.mean;
    let below = normalCdf(distance, INVERSE_SCALES[this.scale]);
    if (this.weight < 65536) {
      below = Math.floor(
        (below * this.weight + normalCdf(distance, INVERSE_SCALES[this.wide]) * (65536 - this.weight)) / 65536,
      );
    }
    return Math.floor((below * (TOTAL - ESCAPE - count)) / TOTAL) + place;
  }
}

const CENTRED: (Mixture | undefined)[] = [];

/** The normal of mean 0 of this entry of the scale table; what it computed once it knows. */
export const centred = (scale: number): Mixture => (CENTRED[scale] ??= new Mixture(0, scale));
