// Quantisation steps of Gaussians and of motion.

import { BITS, COEFFICIENTS, STEP_BITS } from "./layout.ts";

const C = Int32Array.from(COEFFICIENTS.flat());

/** Returns the constant term of the exponent of each step and class, including the rounding term. */
export function constantTerms(coded: Int32Array): Int32Array {
  return Int32Array.from({ length: 8 * coded.length }, (_, i) => {
    return (coded[i >> 3] + (i & 7) * 2 ** STEP_BITS) * 2 ** BITS + 2 ** (BITS + STEP_BITS - 1);
  });
}

export class Steps {
  readonly #exponents: Int32Array;

  constructor(stepExponents: Int32Array) {
    this.#exponents = constantTerms(stepExponents);
  }

  /**
   * Returns `-log2` of a step, rounded. It grows with the class and with the scales and opacity, as `COEFFICIENTS`
   * defines.
   */
  exponent(which: number, level: number, area: number, long: number, thin: number, opacity: number): number {
    const c = 4 * which;
    return (
      (C[c] * area + C[c + 1] * long + C[c + 2] * thin + C[c + 3] * opacity + this.#exponents[8 * which + level]) >>
      (BITS + STEP_BITS)
    );
  }

  /** Returns log2 of a step in fixed-point units, 0 to `most`. */
  shift(which: number, level: number, area: number, long: number, thin: number, opacity: number, most: number): number {
    return Math.min(Math.max(BITS - this.exponent(which, level, area, long, thin, opacity), 0), most);
  }
}
