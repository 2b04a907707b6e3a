// Integer tables of the causal codec: entries of the scale table for spreads, and weights of existence.

const CELLS = 256;

export function exactSixteenths(cell: number): number {
  return 16 * (2 ** (cell / CELLS) - 1);
}

export function exactExists(index: number): number {
  return 65536 / (1 + Math.exp((128 - index) / 16));
}

/** Sixteenths of an octave's linear mantissa by 256ths of its logarithm: floor(16 (2^(cell / 256) - 1)). */
export const SIXTEENTHS = Int32Array.from({ length: CELLS }, (_, cell) => Math.floor(exactSixteenths(cell)));

/** The logistic function at multiples of 1/16 from -8 on, out of 2^16, kept between 32 and 65504. */
export const EXISTS = Int32Array.from({ length: 256 }, (_, index) => Math.min(Math.max(Math.round(exactExists(index)), 32), 65504));

/** Entry of the scale table for a binary logarithm with 16 fractional bits. */
export function scaleOf(spread: number): number {
  const high = spread + 6 * 65536;
  return Math.min(Math.max((high >> 16) * 16 + SIXTEENTHS[(high >> 8) & 255], 0), 319);
}

/** How probable it is, out of 2^16, that an offset exists. */
export const existsOf = (logit: number): number => EXISTS[Math.min(Math.max(((logit + 2048) >> 12) + 128, 0), 255)];
