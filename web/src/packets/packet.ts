// Packets: a header of 16 bytes and a payload that decodes independently.

import { crc32 } from "./crc32.ts";

export const HEADER_BYTES = 16;
const VERSION = 1;
const NOTHING = new Uint8Array();

export interface Packet {
  readonly block: number;
  /** Index of the packet in its block. With hashed grouping: index of its first element in the block. */
  readonly indexInBlock: number;
  readonly count: number;
  readonly bytes: Uint8Array;
  readonly payload: Uint8Array;
}

/** Returns a packet without its bytes, which are then no longer kept in memory. */
export function withoutBytes(packet: Packet): Packet {
  return { ...packet, bytes: NOTHING, payload: NOTHING };
}

/** Upper bound of indices in a block, which a header stores in 14 bits. */
const MAX_INDEX = 1 << 14;

/** Number that names a packet within its stream: no two packets of a stream have the same block and index in it. */
export function identityOf({ block, indexInBlock }: Pick<Packet, "block" | "indexInBlock">): number {
  return block * MAX_INDEX + indexInBlock;
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
    indexInBlock: ((part >> 2) << 8) | view.getUint8(6),
    count,
    bytes,
    payload: bytes.subarray(HEADER_BYTES),
  };
}
