// Made by web/scripts/make_tables.py; do not edit.

// Constants of the motion codec. Counterpart of `splatwire.codec.sequence.layout`, which describes them.

export const NUM_CHANNELS = 13;
export const KIND_OF = [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4];
export const NUM_KINDS = 5;
export const TRACK = 0;
export const STATE = 1;
export const BEGINS = 2;
export const ENDS = 3;
export const GAP_BEFORE = 4;
export const GAP_AFTER = 5;
export const HEADER_FIELDS = 6;
export const STILL = 0;
export const MOVING = 1;
export const MAX_GROUP_FRAMES = 64;
export const MAX_TRACK_SPAN = 4096;
export const SPAN_BITS = 13;
export const TRACK_BITS = 28;
export const NUM_NEIGHBOURS = 8;
export const WEIGHT_BITS = 12;
export const POSITION_BITS = 20;
export const MAX_LOG2_RATIO = 20;
export const MAX_COORD = 1125899906842624;
export const MAX_COEFFICIENT = 68719476736;
export const MAX_QUANTISED = 1073741823;
export const DEGREE_CONTEXTS = 8;
export const NEIGHBOUR_CONTEXTS = 10;
export const OCTAVE_CONTEXTS = 16;
export const MAX_OCTAVE = 29;
export const C_ABSENT = 0;
export const C_MOVING = 2;
export const C_ENDS = 6;
export const C_BEGINS = 7;
export const C_ZERO = 8;
export const C_OCTAVE = 408;
export const NUM_CONTEXTS = 1208;
export const WEIGHT = 4096;
