// Integer tables of the causal codec: scale table entries of deviations, and probabilities that offsets exist.

const CELLS = 256;

export function exactSixteenths(cell: number): number {
  return 16 * (2 ** (cell / CELLS) - 1);
}

export function exactExists(index: number): number {
  return 65536 / (1 + Math.exp((128 - index) / 16));
}

/** Mantissa in sixteenths for each 256th of an octave: floor(16 (2^(cell / 256) - 1)). */
export const SIXTEENTHS = Int32Array.from({ length: CELLS }, (_, cell) => Math.floor(exactSixteenths(cell)));

/** Logistic function at multiples of 1/16 from -8, out of 2^16, clamped to [32, 65504]. */
export const EXISTS = Int32Array.from({ length: 256 }, (_, index) =>
  Math.min(Math.max(Math.round(exactExists(index)), 32), 65504),
);

const EXP2_CELLS = 10,
  EXP2_BITS = 40,
  LOG_BITS = 24,
  FRACTION = 2 ** (LOG_BITS - EXP2_CELLS),
  MAX_LOG = 60;

let cached: Float64Array | null = null;

/**
 * Returns the powers of two from 1 to 2 at multiples of 1/1024, out of 2^40. They are computed with integer square
 * roots because the last bit of `Math.pow` depends on the machine.
 */
export function powers(): Float64Array {
  return (cached ??= exactPowers());
}

function exactPowers(): Float64Array {
  const bits = 128n,
    half = 1n << (bits - BigInt(EXP2_BITS) - 1n);
  let root = 2n << bits,
    value = 1n << bits;
  for (let n = 0; n < EXP2_CELLS; n++) root = squareRoot(root << bits);
  return Float64Array.from({ length: 2 ** EXP2_CELLS + 1 }, () => {
    const entry = Number((value + half) >> (bits - BigInt(EXP2_BITS)));
    value = (value * root) >> bits;
    return entry;
  });
}

/** Newton's method for the integer square root, beginning above it. */
function squareRoot(value: bigint): bigint {
  let root = 1n << BigInt(Math.ceil(value.toString(2).length / 2));
  for (let next = (root + value / root) >> 1n; next < root; next = (root + value / root) >> 1n) root = next;
  return root;
}

/**
 * Returns two to the power of a logarithm with 24 fractional bits, as a 32-bit float. The result is the same on every
 * machine.
 */
export function exactPower(log: number): number {
  const clipped = Math.min(Math.max(log, -MAX_LOG * 2 ** LOG_BITS), MAX_LOG * 2 ** LOG_BITS),
    whole = Math.floor(clipped / 2 ** LOG_BITS),
    rest = clipped - whole * 2 ** LOG_BITS;
  const cell = Math.floor(rest / FRACTION),
    table = powers(),
    low = table[cell];
  return Math.fround(
    (low + Math.floor(((table[cell + 1] - low) * (rest % FRACTION)) / FRACTION)) * 2 ** (whole - EXP2_BITS),
  );
}

/** Returns the scale table entry for a binary logarithm with 16 fractional bits. */
export function scaleOf(logDeviation: number): number {
  const high = logDeviation + 6 * 65536;
  return Math.min(Math.max((high >> 16) * 16 + SIXTEENTHS[(high >> 8) & 255], 0), 319);
}

/** Returns the probability, out of 2^16, that an offset exists. */
export const existsOf = (logit: number): number => EXISTS[Math.min(Math.max(((logit + 2048) >> 12) + 128, 0), 255)];
