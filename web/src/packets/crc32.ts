// CRC-32 as in zlib: that of node, which is much faster, or a portable one.

import { builtin } from "../node.ts";

interface Zlib {
  crc32?(bytes: Uint8Array, before: number): number;
}

const SLICES = 8;

/**
 * Checksums of a byte with 0 to 7 zero bytes behind it, 256 entries each. Eight bytes at a time are looked up
 * independently (slicing by 8, Kounavis and Berry, 2008).
 */
const TABLE = new Int32Array(256 * SLICES);

function fillTable(): void {
  for (let n = 0; n < 256; n++) {
    let crc = n;
    for (let k = 0; k < 8; k++) crc = crc & 1 ? 0xedb88320 ^ (crc >>> 1) : crc >>> 1;
    TABLE[n] = crc;
  }
  for (let n = 256; n < TABLE.length; n++) TABLE[n] = (TABLE[n - 256] >>> 8) ^ TABLE[TABLE[n - 256] & 255];
}

let found: Zlib["crc32"];

/** Returns the checksum of `bytes`, continued from the checksum `before` of earlier bytes. */
export function crc32(bytes: Uint8Array, before = 0): number {
  found ??= builtin<Zlib>("zlib")?.crc32 ?? portableCrc32;
  return found(bytes, before);
}

/** Computes the same without node. */
export function portableCrc32(bytes: Uint8Array, before: number): number {
  if (!TABLE[1]) fillTable();
  let crc = ~before,
    i = 0;
  for (; i + SLICES <= bytes.length; i += SLICES) {
    crc ^= bytes[i] | (bytes[i + 1] << 8) | (bytes[i + 2] << 16) | (bytes[i + 3] << 24);
    crc =
      TABLE[0x700 + (crc & 255)] ^
      TABLE[0x600 + ((crc >>> 8) & 255)] ^
      TABLE[0x500 + ((crc >>> 16) & 255)] ^
      TABLE[0x400 + (crc >>> 24)] ^
      TABLE[0x300 + bytes[i + 4]] ^
      TABLE[0x200 + bytes[i + 5]] ^
      TABLE[0x100 + bytes[i + 6]] ^
      TABLE[bytes[i + 7]];
  }
  for (; i < bytes.length; i++) crc = TABLE[(crc ^ bytes[i]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}
