// Integer tables behind the range coder: the twin of `splatwire.entropy.tables`.

import { UPPER_NORMAL } from "./normal_table.ts";

export const TOTAL_BITS = 24,
  MEAN_BITS = 12,
  SCALE_STEPS = 16,
  NUM_SCALES = 320;
export const Z_CELL_BITS = 9,
  Z_LIMIT = 6 * 65536;
const INVERSE_BITS = 20;

/** Distribution function at multiples of 1/128 from -6 to 6, out of 2^24. */
export const NORMAL: Int32Array = (() => {
  const bytes = Uint8Array.from(atob(UPPER_NORMAL), (c) => c.charCodeAt(0)),
    half = bytes.length / 3 - 1;
  const table = new Int32Array(2 * half + 1);
  for (let i = 0; i <= half; i++) {
    const value = bytes[3 * i] + bytes[3 * i + 1] * 256 + bytes[3 * i + 2] * 65536;
    table[half + i] = 2 ** (TOTAL_BITS - 1) + value;
    table[half - i] = 2 ** (TOTAL_BITS - 1) - value;
  }
  return table;
})();

/** Reciprocals of the scales with 20 fractional bits: entry 16 e + m stands for 2^(e - 6) (1 + (m + 1/2) / 16). */
export const INVERSE_SCALES: Int32Array = Int32Array.from({ length: NUM_SCALES }, (_, index) => {
  const numerator = 2 * SCALE_STEPS * 2 ** (INVERSE_BITS + 6);
  const denominator = (2 * SCALE_STEPS + 2 * (index % SCALE_STEPS) + 1) * 2 ** Math.floor(index / SCALE_STEPS);
  return Math.floor((2 * numerator + denominator) / (2 * denominator));
});

/** Half width, in symbols, of the window in which symbols have an interval of their own. */
export const HALF_WIDTHS: Int32Array = INVERSE_SCALES.map((inverse) =>
  Math.min(8191, Math.floor((10 * 2 ** INVERSE_BITS) / inverse) + 16),
);
