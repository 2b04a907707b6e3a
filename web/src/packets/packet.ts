// The packet: a header of 16 bytes and a payload that decodes alone.

import { crc32 } from "./crc32.ts";

export const HEADER_BYTES = 16;
const VERSION = 1;

export interface Packet {
  readonly block: number;
  /** With hashed grouping the position of its first element in the block. */
  readonly lane: number;
  readonly count: number;
  readonly bytes: Uint8Array;
  readonly payload: Uint8Array;
}

/**
 * A packet of this stream, or null: damaged, foreign, of a newer version, or one that holds only a part of its
 * elements.
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
