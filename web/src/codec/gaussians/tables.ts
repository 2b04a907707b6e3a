// Integer tables of the Gaussians' codec.

import { BITS, MAX_THIN } from "./layout.ts";

/**
 * Logarithm r of a ratio of scales for companded values t = (1 - 2^-r) / ln 2. No entry but the first lies nearer than
 * 1e-5 to where rounding up changes (a test says so), a billion times the error of a double.
 */
export const THINNESS = Int32Array.from({ length: MAX_THIN + 1 }, (_, t) => (t ? Math.ceil(exactThinness(t)) : 0));

export function exactThinness(t: number): number {
  return -Math.log2(1 - (t * Math.LN2) / 2 ** BITS) * 2 ** BITS;
}
