// Made by web/scripts/make_tables.py; do not edit.

// Constants of the Gaussian codec. Counterpart of `splatwire.codec.gaussians.layout`, which describes them.

export const BITS = 12;
export const DIRECTION_BITS = 14;
export const STEP_BITS = 6;
export const POSITION = 0;
export const CLASS = 3;
export const OPACITY = 4;
export const SCALE0 = 5;
export const ELONGATION = 6;
export const FLATNESS = 7;
export const AXIS = 8;
export const PRIMARY = 11;
export const SPIN_BITS = 12;
export const SPIN = 13;
export const LUMA = 14;
export const COLUMNS = 17;
export const RESIDUAL_KINDS = 8;
export const RESIDUAL_OPACITY = 0;
export const RESIDUAL_SCALE0 = 1;
export const RESIDUAL_ELONGATION = 2;
export const RESIDUAL_FLATNESS = 3;
export const RESIDUAL_DIRECTION = 4;
export const RESIDUAL_LUMA = 5;
export const NUM_DEVIATION_CONTEXTS = 12;
export const NUM_MAGNITUDE_CONTEXTS = 16;
export const STEPS = 9;
export const STEP_OPACITY = 0;
export const STEP_SCALE0 = 1;
export const STEP_ELONGATION = 2;
export const STEP_FLATNESS = 3;
export const STEP_POSITION = 4;
export const STEP_DIRECTION = 5;
export const STEP_SPIN = 6;
export const STEP_COLOUR = 7;
export const STEP_HARMONICS = 8;
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
export const MAX_CLASSES = 8;
export const POSITION_CONTEXTS = 32;
export const CLASS_CONTEXTS = 144;
export const HARMONIC_CONTEXTS = 96;
export const FIRST_CLASS = 32;
export const FIRST_HARMONIC = 176;
export const FIRST_MAGNITUDE = 248;
export const NUM_CONTEXTS = 272;
export const NUM_NEIGHBOURS = 6;
export const WINDOW = 64;
export const MAX_SQUARED_DISTANCE = 1099511627776;
export const MAX_LOG = 163840;
export const MAX_LOG_OPACITY = -1;
export const MIN_LOG_OPACITY = -40960;
export const ASSUMED_ELONGATION = 8192;
export const MAX_COLOUR = 1048576;
export const MAX_HARMONIC = 16777216;
export const TRANSFORM_UNIT = 127;
export const MAX_RESIDUAL = 16777216;
export const MAX_COMPANDED = 5903;
export const MAX_FLATNESS = 10;
export const WIDE_SCALE_OFFSET = 24;
export const NARROW_WEIGHT = 45875;
export const SCALE_INDEX_STEP = 4;
export const MEAN_FRACTION_BITS = 3;
export const SLOT_BITS = 8;
export const MAX_LATTICE_BITS = 40;
export const MAX_CELL_BITS = 21;
export const ONE = 16384;
export const BOX_BITS = 8;
