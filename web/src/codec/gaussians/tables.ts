// Integer tables of the codec of explicit Gaussians.

import { BITS, MAX_COMPANDED } from "./layout.ts";

let table: Int32Array | null = null;

/**
 * Returns the log ratios r of scales for companded values t = (1 - 2^-r) / ln 2. Every entry but the first is at least
 * 1e-5 from a rounding boundary (tested), a billion times the error of a double.
 */
export function flatnessTable(): Int32Array {
  table ??= Int32Array.from({ length: MAX_COMPANDED + 1 }, (_, t) => (t ? Math.ceil(exactFlatness(t)) : 0));
  return table;
}

export function exactFlatness(t: number): number {
  return -Math.log2(1 - (t * Math.LN2) / 2 ** BITS) * 2 ** BITS;
}
