// Made by web/scripts/make_tables.py; do not edit.

// Constants of the wire protocol. Counterpart of `splatwire.transport.protocol`, which describes them.

export const VERSION = 4;
export const REQUEST = 3;
export const WELCOME = 4;
export const INIT_SYMBOL = 5;
export const DATA = 6;
export const PARITY = 7;
export const FEEDBACK = 8;
export const BYE = 9;
export const REFUSE = 10;
export const END = 11;
export const HAVE = 12;
export const VIEW_UPDATE = 13;
export const LIVE = 1;
export const VIEW_DEPENDENT = 2;
export const MAX_DATAGRAM = 1200;
export const REFUSALS = [
  "",
  "no such stream",
  "the server is full",
  "the server stopped",
  "too many transfers from this network",
  "nothing is there yet",
  "the server has another protocol version",
  "the scene needs a valid token",
  "the port serves another transport",
];
export const NOT_YET = 5;
export const OTHER_VERSION = 6;
export const MAX_NAME = 64;
export const MAX_NACKS = 250;
export const MAX_PARITY_RANGES = 130;
export const MAX_DECLARED = 1104;
export const MAX_PREVIEW = 1024;
export const MAX_HELD_BYTES = 1100;
export const MAX_NACK_ATTEMPTS = 8;
export const MAX_GAPS = 4096;
export const REORDER_THRESHOLD = 48;
export const MAX_SEQUENCE_JUMP = 131072;
export const MAX_FRUITLESS_ENDS = 25;
export const MAX_INIT_SEGMENT_BYTES = 268435456;
export const MAX_PACKETS = 2097152;
export const NACK_INTERVAL_MS = 120;
export const FEEDBACK_MS = 20;
