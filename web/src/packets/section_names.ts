// Made by web/scripts/make_tables.py; do not edit.

// Names of sections of the side information.

export const ANTIALIASED = "antialiased";
export const BACKGROUND = "background";
export const EXTENT = "extent";
export const FIRST_FRAME = "first_frame";
export const LIFETIMES = "lifetimes";
export const METADATA = "metadata";
export const ORIGIN = "origin";
export const PREVIEW = "preview";
export const SKETCH = "sketch";
export const TIERS = "tiers";
export const TIER_SIZES = "tier_sizes";
export const TILES = "tiles";
export const UP = "up";
export const VIEWPOINT = "viewpoint";
