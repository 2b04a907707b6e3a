// Steps in which Gaussians are quantised: what they are, and what moves of them.

import { BITS, COEFFICIENTS, STEP_BITS } from "./layout.ts";

const C = Int32Array.from(COEFFICIENTS.flat());

export class Steps {
  /** Of each step and class, with what rounds. */
  readonly #bases: Int32Array;

  constructor(bases: Int32Array) {
    this.#bases = Int32Array.from({ length: 8 * bases.length }, (_, i) => {
      return (bases[i >> 3] + (i & 7) * 2 ** STEP_BITS) * 2 ** BITS + 2 ** (BITS + STEP_BITS - 1);
    });
  }

  /** `-log2` of a step, rounded: finer with the class, and as `COEFFICIENTS` says. */
  exponent(which: number, level: number, area: number, long: number, thin: number, opacity: number): number {
    const c = 4 * which;
    return (
      (C[c] * area + C[c + 1] * long + C[c + 2] * thin + C[c + 3] * opacity + this.#bases[8 * which + level]) >>
      (BITS + STEP_BITS)
    );
  }

  /** log2 of a step in units of the fixed point, from 0 to `most`. */
  shift(which: number, level: number, area: number, long: number, thin: number, opacity: number, most: number): number {
    return Math.min(Math.max(BITS - this.exponent(which, level, area, long, thin, opacity), 0), most);
  }
}
