// Made by web/scripts/make_tables.py; do not edit.

// Limits of the stream format. Counterpart of `splatwire.bitstream.limits`.

export const MANIFEST_FORMAT = "splatwire/stream";
export const FORMAT_VERSION = 5;
export const MAX_BLOCK_SIZE = 65535;
export const MAX_HASHED_BLOCK = 16384;
export const MAX_BLOCKS = 16777216;
export const MAX_LANES = 256;
export const MAX_STREAM_LANES = 2147483647;
export const MIN_PACKET_BYTES = 128;
export const MAX_HASHED_PACKET_BYTES = 65507;
export const MAX_PACKET_BYTES = 67108864;
export const MAX_TIERS = 8;
export const MAX_SPANS = 4096;
export const MAX_FEATURE_GROUPS = 64;
export const CODING_ORDERS = ["morton", "raster"];
export const GROUPINGS = ["stratified", "contiguous", "hashed"];
export const PACKAGINGS = ["atomic", "separated"];
export const MAX_MANIFEST_BYTES = 65536;
export const MAX_SIDE_INFO_BYTES = 4294967295;
export const MAX_WRITER_LENGTH = 80;
export const MAX_FEATURE_DIM = 4096;
export const MAX_OFFSETS = 1024;
export const MAX_SECTIONS = 16;
export const MAX_SECTION_BYTES = 67108864;
export const MAX_SECTION_NAME = 32;
export const MAX_ELEMENTS = 268435456;
export const FREE_ELEMENTS = 65536;
export const FREE_BYTES = 157286400;
export const BYTES_PER_BYTE = 160;
export const MAX_POSITION_BITS = 63;
export const MAX_COORD = 1099511627776;
export const MAX_CENTRE_DISTANCE = 33554432;
export const MAX_LEAF = 64;
export const MAX_CAUSAL_GROUPS = 32;
export const MAX_CAUSAL_FEATURES = 256;
export const MAX_CAUSAL_OFFSETS = 64;
export const MAX_CAUSAL_CONTEXT = 256;
export const MAX_CAUSAL_STEP_OF_LOGS = 67108864;
export const MAX_CAUSAL_ZERO_POINT = 536870912;
export const MAX_DEGREE = 3;
export const MAX_FRAMES = 1048576;
export const MAX_GROUP_FRAMES = 64;
export const MAX_FRAME_RATE = 1000;
export const MAX_SIZE_LOG = 32;
export const MAX_COPIES = 65535;
export const UNNAMED_SCHEMA = "hacpp";
export const RESERVED_SECTIONS = [
  "header",
  "positions",
  "grid",
  "prior_network",
  "channel_networks",
  "render_networks",
  "mask_models",
];
export const SCHEMAS = {
  hacpp: {
    formatVersion: 1,
    elements: "anchors",
    sections: ["header", "positions", "grid", "prior_network", "channel_networks", "render_networks", "mask_models"],
    elementsPerByte: 1024,
    maxTiers: 8,
    timed: false,
  },
  causal: {
    formatVersion: 2,
    elements: "anchors",
    sections: ["header", "positions", "networks", "render_networks"],
    elementsPerByte: 1024,
    maxTiers: 8,
    timed: false,
  },
  gaussians: {
    formatVersion: 2,
    elements: "Gaussians",
    sections: ["header", "blocks", "contexts"],
    elementsPerByte: 9362,
    maxTiers: 8,
    timed: false,
  },
  levels: {
    formatVersion: 4,
    elements: "Gaussians",
    sections: ["header", "blocks", "contexts"],
    elementsPerByte: 9362,
    maxTiers: 8,
    timed: false,
  },
  update: {
    formatVersion: 5,
    elements: "Gaussians",
    sections: ["header", "blocks", "contexts"],
    elementsPerByte: 9362,
    maxTiers: 8,
    timed: false,
  },
  tracks: {
    formatVersion: 3,
    elements: "tracks",
    sections: ["clip", "keyframes", "motion"],
    elementsPerByte: 9362,
    maxTiers: 4096,
    timed: true,
  },
};
