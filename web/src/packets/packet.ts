// Packets: a header of 16 bytes and a payload that decodes independently.

import { crc32 } from "./crc32.ts";

export const HEADER_BYTES = 16;
const VERSION = 1;

export interface Packet {
  readonly block: number;
  /** Lane within the block. With hashed grouping: the position of the first element in the block. */
  readonly lane: number;
  readonly count: number;
  readonly bytes: Uint8Array;
  readonly payload: Uint8Array;
}

/** Lanes of a block that a header can name. */
const MAX_LANES = 1 << 14;

/** Number that names a packet within its stream: no two packets of a stream have the same block and lane. */
export function identityOf({ block, lane }: Pick<Packet, "block" | "lane">): number {
  return block * MAX_LANES + lane;
}

/**
 * Reads a packet of this stream. Returns null if it is damaged, of another stream, of a newer version, or contains only
 * some attributes of its elements.
 */
export function readPacket(bytes: Uint8Array, streamId: number): Packet | null {
  if (bytes.length < HEADER_BYTES) return null;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const part = view.getUint8(5),
    count = view.getUint16(10, true);
  const whole = view.getUint8(0) === VERSION && view.getUint32(1, true) === streamId && (part & 3) === 0 && count > 0;
  if (!whole || crc32(bytes.subarray(HEADER_BYTES), crc32(bytes.subarray(0, 12))) !== view.getUint32(12, true))
    return null;
  return {
    block: view.getUint16(7, true) | (view.getUint8(9) << 16),
    lane: ((part >> 2) << 8) | view.getUint8(6),
    count,
    bytes,
    payload: bytes.subarray(HEADER_BYTES),
  };
}
