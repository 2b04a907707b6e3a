// Numbers that encoder and decoder of motion share: the twin of `splatwire.codec.schemas.tracks.layout`.

/** Channels: place, rotation, three scales, opacity, Y Co Cg; and the kind of each. */
export const KIND_OF = [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4],
  NUM_CHANNELS = KIND_OF.length,
  NUM_KINDS = 5;

/** Columns of a head: track, state, first frame, frame after, tracks before it that are gone, and after it. */
export const TRACK = 0,
  STATE = 1,
  BEGINS = 2,
  ENDS = 3,
  BEFORE = 4,
  AFTER = 5,
  HEAD = 6;
export const MOVING = 1;
export const MAX_CANDIDATES = 4096,
  CANDIDATE_BITS = 13,
  TRACK_BITS = 28;

export const NUM_NEIGHBOURS = 8,
  WEIGHT = 1 << 12,
  PLACE_BITS = 20,
  MAX_COEFFICIENT = 2 ** 36,
  MAX_QUANTISED = 2 ** 30 - 1;

/** Contexts of a coefficient: its order, how large those next to it were; and of its octave. */
export const ORDERS = 8,
  LEVELS = 10,
  MAGNITUDES = 16,
  MAX_OCTAVE = 29;
export const C_GONE = 0,
  C_MOVING = 2,
  C_ENDS = 6,
  C_BEGINS = 7,
  C_ZERO = 8,
  C_OCTAVE = C_ZERO + NUM_KINDS * ORDERS * LEVELS,
  NUM_CONTEXTS = C_OCTAVE + NUM_KINDS * LEVELS * MAGNITUDES;
