// The digest of all decoded integers, which proves that both ends coded with the same tables.

import { sha256 } from "@noble/hashes/sha2.js";
import { hex } from "../../bytes.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Pause } from "../../turns.ts";
import type { Decoded } from "./packet.ts";

/**
 * Rows as 64-bit integers, then harmonics as 32-bit ones, block by block; `blocks` has the packets of each, in order.
 */
export async function symbolsDigest(
  blocks: readonly (readonly Packet[])[],
  pause: Pause,
  decode: (packet: Packet) => Decoded,
): Promise<string> {
  const digest = sha256.create();
  for (const block of blocks) {
    const packets: Decoded[] = [];
    for (const packet of block) {
      await pause();
      packets.push(decode(packet));
    }
    addRows(digest, packets);
  }
  return hex(digest.digest());
}

/** Adds the integers of a block's packets: all rows, then all harmonics. */
export function addRows(digest: { update(bytes: Uint8Array): unknown }, packets: readonly Decoded[]): void {
  for (const { rows } of packets) digest.update(integers64(rows));
  for (const { harmonics } of packets) digest.update(integers32(harmonics));
}

/** Little-endian bytes of 32-bit integers. */
export function integers32(values: Int32Array): Uint8Array {
  const bytes = new DataView(new ArrayBuffer(4 * values.length));
  values.forEach((value, i) => bytes.setInt32(4 * i, value, true));
  return new Uint8Array(bytes.buffer);
}

function integers64(values: Float64Array): Uint8Array {
  const bytes = new DataView(new ArrayBuffer(8 * values.length));
  values.forEach((value, i) => {
    bytes.setUint32(8 * i, value - Math.floor(value / 2 ** 32) * 2 ** 32, true);
    bytes.setInt32(8 * i + 4, Math.floor(value / 2 ** 32), true);
  });
  return new Uint8Array(bytes.buffer);
}
