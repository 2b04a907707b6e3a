// Digest of all decoded integers. Equal digests prove that encoder and decoder used the same tables.

import type { Packet } from "../../packets/packet.ts";
import type { Pause } from "../../scheduler.ts";
import { newSha256 } from "../../sha256.ts";
import { compressFast } from "./native.ts";
import type { Decoded } from "./packet.ts";

/**
 * Verification of a stream while it is decoded, so that its digest needs no second pass; null for none until `digest`
 * is called.
 */
export type Verification = {
  /** Memory for integers that are hashed later, bytes. */
  readonly keptBytes: number;
  /** Size of a file if all packets are decoded at once, so that all Gaussians are in the same arrays. */
  readonly fileBytes?: number;
} | null;

/** Largest number of waiting packets. It limits the time for a file of many small packets in the reverse order. */
const MAX_PENDING = 4096;

/** Decoded packet. */
interface Pending {
  readonly packet: Packet;
  readonly decoded: Decoded;
}

const bytesOf = ({ rows, integers, harmonics }: Decoded): number =>
  (integers ?? rows).byteLength + harmonics.byteLength;

/**
 * Computes the digest block by block: rows as 64-bit integers, then harmonics as 32-bit integers. Packets that are
 * added in the order of the plan, as those of a file, need not be decoded again. The same is true of other orders
 * while at most `MAX_PENDING` packets, whose integers take at most `keptBytes` bytes, wait for those before them.
 */
export class SymbolsDigest {
  #hash = newSha256(compressFast);
  /** Packets that are not hashed yet, in the order of the plan, and the bytes of their integers. */
  readonly #pending: Pending[] = [];
  #bytes = 0;
  /** True as long as packets were added in order. */
  #inOrder = true;
  /** Last packet and harmonics of the current block, and the number of packets of each block. */
  #lastIndex = -1;
  #harmonics: Int32Array[] = [];
  readonly #added: number[] = [];

  constructor(readonly keptBytes = 0) {}

  /** Adds a decoded packet. The integers may change afterwards only if `keptBytes` is 0. */
  add(packet: Packet, decoded: Decoded): void {
    if (!this.#inOrder) return;
    const pending = this.#pending,
      { block, indexInBlock } = packet,
      isLater = ({ packet: other }: Pending): boolean => (other.block - block || other.indexInBlock - indexInBlock) > 0;
    let at = pending.length;
    while (at && isLater(pending[at - 1])) at--;
    pending.splice(at, 0, { packet, decoded });
    this.#bytes += bytesOf(decoded);
    this.#hashPending(this.keptBytes);
  }

  /** Hashes pending packets in the order of the plan until the integers of the others take at most `most` bytes. */
  #hashPending(most: number): void {
    while (this.#bytes > most || this.#pending.length > MAX_PENDING) {
      const { packet, decoded } = this.#pending.shift()!;
      this.#bytes -= bytesOf(decoded);
      this.#hashNext(packet, decoded);
    }
  }

  #hashNext({ block, indexInBlock }: Packet, { rows, harmonics, integers }: Decoded): void {
    while (this.#added.length <= block) this.#beginBlock();
    this.#inOrder &&= this.#added.length === block + 1 && indexInBlock > this.#lastIndex;
    if (!this.#inOrder) return;
    this.#lastIndex = indexInBlock;
    this.#added[block]++;
    this.#hash.update(integers ?? integers64(rows));
    if (harmonics.length) this.#harmonics.push(this.keptBytes ? harmonics : harmonics.slice());
  }

  #beginBlock(): void {
    for (const harmonics of this.#harmonics) this.#hash.update(integers32(harmonics));
    this.#harmonics = [];
    this.#lastIndex = -1;
    this.#added.push(0);
  }

  /** Returns the digest. `blocks` has the packets of each block in order. */
  async finish(
    blocks: readonly (readonly Packet[])[],
    pause: Pause,
    decode: (packet: Packet) => Decoded,
  ): Promise<string> {
    this.#hashPending(0);
    while (this.#added.length <= blocks.length) this.#beginBlock();
    if (this.#inOrder && blocks.every((packets, block) => packets.length === this.#added[block]))
      return this.#hash.hex();
    this.#hash = newSha256(compressFast);
    for (const packets of blocks) {
      const found: Decoded[] = [];
      for (const packet of packets) {
        await pause();
        found.push(decode(packet));
      }
      addRows(this.#hash, found);
    }
    return this.#hash.hex();
  }
}

/** Adds the integers of a block's packets: all rows, then all harmonics. */
export function addRows(digest: { update(bytes: Uint8Array): unknown }, packets: readonly Decoded[]): void {
  for (const { rows, integers } of packets) digest.update(integers ?? integers64(rows));
  for (const { harmonics } of packets) if (harmonics.length) digest.update(integers32(harmonics));
}

/** True if numbers are stored with the low byte first, as on all common processors. */
const LITTLE_ENDIAN = new Uint8Array(Uint16Array.of(1).buffer)[0] === 1;

/** Returns 32-bit integers as little-endian bytes. */
export function integers32(values: Int32Array): Uint8Array {
  if (LITTLE_ENDIAN) return new Uint8Array(values.buffer, values.byteOffset, values.byteLength);
  const bytes = new DataView(new ArrayBuffer(4 * values.length));
  values.forEach((value, i) => bytes.setInt32(4 * i, value, true));
  return new Uint8Array(bytes.buffer);
}

/** Memory for the halves of 64-bit integers, used again for every packet. */
let halvesBuffer = new Int32Array();

/** Returns 64-bit integers as little-endian bytes, until the next call. */
function integers64(values: Float64Array): Uint8Array {
  if (halvesBuffer.length < 2 * values.length) halvesBuffer = new Int32Array(2 * values.length);
  const halves = halvesBuffer.subarray(0, 2 * values.length);
  for (let i = 0; i < values.length; i++) {
    const value = values[i],
      low = value | 0; // the low 32 bits also of larger integers
    halves[2 * i] = low;
    halves[2 * i + 1] = low === value ? low >> 31 : Math.floor(value / 2 ** 32);
  }
  return integers32(halves);
}
