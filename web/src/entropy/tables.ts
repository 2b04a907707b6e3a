// Integer tables of the range coder. Counterpart of `splatwire.entropy.tables`.

export const TOTAL_BITS = 24,
  MEAN_BITS = 12,
  SCALE_STEPS = 16,
  NUM_SCALES = 320;
export const Z_CELL_BITS = 9,
  Z_LIMIT = 6 * 65536;
const INVERSE_BITS = 20;

const ROOT_2_PI = 2.5066282746310002,
  /** Terms of the series; enough for double precision up to z = 6. */
  TERMS = 100;

/**
 * Normal distribution function at multiples of 1/128 from -6 to 6, out of 2^24.
 *
 * It is 1/2 + phi(z) (z + z^3/3 + z^5/15 ...) with phi(z) = 1 / (sqrt(2 pi) (1 + z^2/2 + z^4/8 + ...)). Additions,
 * multiplications and divisions of doubles give the same result on every machine. The error is below 2e-8. No exact
 * value is within 4e-6 of a rounding boundary.
 */
export const NORMAL: Int32Array = (() => {
  const half = Z_LIMIT >> Z_CELL_BITS,
    table = new Int32Array(2 * half + 1);
  for (let i = 0; i <= half; i++) {
    const z = (6 * i) / half;
    let odd = z,
      even = 1,
      above = z,
      inverse = 1;
    for (let k = 1; k < TERMS; k++) {
      even *= (z * z) / (2 * k);
      odd *= (z * z) / (2 * k + 1);
      inverse += even;
      above += odd;
    }
    const value = i < half ? Math.round((2 ** TOTAL_BITS * above) / (inverse * ROOT_2_PI)) : 2 ** (TOTAL_BITS - 1);
    table[half + i] = 2 ** (TOTAL_BITS - 1) + value;
    table[half - i] = 2 ** (TOTAL_BITS - 1) - value;
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
