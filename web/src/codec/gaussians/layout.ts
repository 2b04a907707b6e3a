// Numbers that encoder and decoder share: the twin of `splatwire.codec.schemas.gaussians.layout`.

export const BITS = 12,
  DIRECTION_BITS = 14,
  STEP_BITS = 6;
export const ONE = 1 << DIRECTION_BITS;

/** Columns of a decoded Gaussian. */
export const LATTICE = 0,
  CLASS = 3,
  OPACITY = 4,
  SCALE0 = 5,
  SCALE1 = 6,
  SCALE2 = 7,
  AXIS = 8,
  PRIMARY = 11;
export const SPIN_BITS = 12,
  SPIN = 13,
  LUMA = 14,
  COLUMNS = 17;

export const STREAMS = 8,
  SPREADS = 12,
  SECONDS = 16;

/** What has a step of its own, in the order of the side information. */
export const S_OPACITY = 0,
  S_SCALE0 = 1,
  S_SCALE1 = 2,
  S_SCALE2 = 3,
  S_POSITION = 4,
  S_DIRECTION = 5,
  S_SPIN = 6;
export const S_COLOUR = 7,
  S_HARMONICS = 8,
  STEPS = 9;

/**
 * Octaves (out of 64) by which a step is finer for each octave of log2 s0 + log2 s1, log2 s0/s1, log2 s1/s2, log2
 * opacity.
 */
export const COEFFICIENTS = [
  [0, 0, 0, 0],
  [16, 0, 0, 13],
  [16, 0, 0, 13],
  [16, -51, 0, 13],
  [-21, -13, 0, 0],
  [16, 102, 70, 16],
  [19, 51, 154, 16],
  [0, 0, 0, 0],
  [0, 0, 0, 0],
];

export const FIRST_CLASS = 32,
  FIRST_HARMONIC = FIRST_CLASS + 18 * 8,
  FIRST_MAGNITUDE = FIRST_HARMONIC + 8 + 64;
export const NUM_CONTEXTS = FIRST_MAGNITUDE + 24;
export const NUM_NEIGHBOURS = 6,
  WINDOW = 64;
/** Squared distances of neighbours end here: they times 2^12 are exact in a double, too. */
export const FAR = 2 ** 40;
export const MAX_LOG = 40 << BITS,
  MAX_OPACITY = -1,
  MIN_OPACITY = -(10 << BITS),
  MAX_COLOUR = 1 << (BITS + 8);
export const MAX_HARMONIC = 1 << 24,
  MAX_RESIDUAL = 1 << 24,
  MAX_THIN = 5903;
export const WIDE = 24,
  NARROW_WEIGHT = 45875,
  SCALE_UNIT = 4;
export const MAX_LATTICE_BITS = 40,
  MAX_CELL_BITS = 21,
  BOX_BITS = 8,
  SLOT_BITS = 8,
  TRANSFORM_UNIT = 127;
