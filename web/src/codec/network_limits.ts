// Made by web/scripts/make_tables.py; do not edit.

// Size limits of quantised networks. Counterpart of `splatwire.codec.weight_bytes`.

export const MAX_WIDTH = 4096;
export const MAX_WEIGHTS = 1048576;
export const MAX_SHIFT = 12;
export const MAX_STEP = 65535;
export const MAX_SYMBOL = 16777216;
