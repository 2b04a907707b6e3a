// Integer tables of the range coder. Counterpart of `splatwire.entropy.tables`.

export const TOTAL_BITS = 24,
  MEAN_BITS = 12,
  SCALE_STEPS = 16,
  NUM_SCALES = 320;
export const Z_CELL_BITS = 9,
  Z_LIMIT = 6 * 65536;
const INVERSE_BITS = 20;

/** Factor of exp(-z^2 / 2) in the density: 2^24 / sqrt(2 pi). */
const DENSITY = 2 ** TOTAL_BITS / 2.5066282746310002,
  /** Offset of the outer nodes of the quadrature from the middle of a cell, in cells. */
  NODE = Math.sqrt(0.15);

/**
 * Normal distribution function at multiples of 1/128 from -6 to 6, out of 2^24.
 *
 * It is the integral of the density, computed cell by cell by Gauss-Legendre quadrature with three nodes. The error is
 * below 1e-7, and no exact value is within 4e-6 of a rounding boundary. So the table is the same on every machine,
 * although the last bit of `Math.exp` is not.
 */
export const NORMAL: Int32Array = (() => {
  const half = Z_LIMIT >> Z_CELL_BITS,
    cell = 6 / half,
    table = new Int32Array(2 * half + 1).fill(2 ** (TOTAL_BITS - 1)),
    density = (place: number): number => Math.exp((-place * place * cell * cell) / 2);
  for (let i = 1, area = 0; i <= half; i++) {
    const middle = i - 0.5;
    area += (DENSITY * cell * (5 * (density(middle - NODE) + density(middle + NODE)) + 8 * density(middle))) / 18;
    const value = i < half ? Math.round(area) : 2 ** (TOTAL_BITS - 1);
    table[half + i] += value;
    table[half - i] -= value;
  }
  return table;
})();

/** Reciprocals of the scales with 20 fractional bits. Entry 16 e + m is the scale 2^(e - 6) (1 + (m + 1/2) / 16). */
export const INVERSE_SCALES: Int32Array = Int32Array.from({ length: NUM_SCALES }, (_, index) => {
  const numerator = 2 * SCALE_STEPS * 2 ** (INVERSE_BITS + 6);
  const denominator = (2 * SCALE_STEPS + 2 * (index % SCALE_STEPS) + 1) * 2 ** Math.floor(index / SCALE_STEPS);
  return Math.floor((2 * numerator + denominator) / (2 * denominator));
});

/** Half width of the window of symbols with their own interval, in symbols. Symbols outside use an escape code. */
export const HALF_WIDTHS: Int32Array = INVERSE_SCALES.map((inverse) =>
  Math.min(8191, Math.floor((10 * 2 ** INVERSE_BITS) / inverse) + 16),
);
