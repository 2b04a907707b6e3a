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
  readonly #constantTerms: Int32Array;

  constructor(baseExponents: Int32Array) {
    this.#constantTerms = constantTerms(baseExponents);
  }

  /**
   * Returns `-log2` of a step, rounded. It grows with the class and with the scales and opacity, as `COEFFICIENTS`
   * defines.
   */
  exponent(
    quantity: number,
    precisionClass: number,
    area: number,
    elongation: number,
    flatness: number,
    opacity: number,
  ): number {
    const c = 4 * quantity;
    return (
      (C[c] * area +
        C[c + 1] * elongation +
        C[c + 2] * flatness +
        C[c + 3] * opacity +
        this.#constantTerms[8 * quantity + precisionClass]) >>
      (BITS + STEP_BITS)
    );
  }

  /** Returns log2 of a step in fixed-point units, 0 to `maxShift`. */
  shift(
    quantity: number,
    precisionClass: number,
    area: number,
    elongation: number,
    flatness: number,
    opacity: number,
    maxShift: number,
  ): number {
    return Math.min(
      Math.max(BITS - this.exponent(quantity, precisionClass, area, elongation, flatness, opacity), 0),
      maxShift,
    );
  }
}
