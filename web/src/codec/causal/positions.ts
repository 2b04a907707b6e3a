// Positions of anchors. The head contains the upper bits of their Morton codes as counts of a binary space partition,
// packets contain the rest.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { RangeDecoder } from "../../entropy/decoder.ts";
import { MAX_COORD, MAX_LEAF, MAX_POSITION_BITS } from "../../packets/limits.ts";
import { decodeTree, TREE_CONTEXTS } from "../code_tree.ts";

const MAX_ROWS = MAX_POSITION_BITS / 3;

/** Upper bits of all anchors' positions, by rank. Coordinates are voxels relative to `corner`. */
export interface Positions {
  readonly corner: readonly number[];
  /** Bits of a Morton code. Bit 0 belongs to x, bit 1 to y, bit 2 to z, bit 3 to x again. */
  readonly bits: number;
  /** Coordinates without the bits that are in the packets, shape (count, 3). */
  readonly upperBits: Int32Array;
  /** Number of each code's bits that are in its packet. */
  readonly numLowBits: Uint8Array;
  /** Number of anchors in the same leaf of the partition, and the anchor's index among them. */
  readonly leafSize: Uint8Array;
  readonly leafIndex: Uint8Array;
  /** Probability, out of 2^8, that all bits above the n-th triple are 0; one row per number of triples. */
  readonly stopProbabilities: readonly Uint8Array[];
}

export function readPositions(bytes: Uint8Array, count: number): Positions {
  const reader = new ByteReader(bytes, "positions"),
    leaf = reader.u8(),
    rows = reader.u8();
  if (leaf < 1 || leaf > MAX_LEAF || rows > MAX_ROWS)
    throw new BitstreamError(`positions: nodes of ${leaf} anchors, ${rows} rows of probabilities`);
  const stopProbabilities = Array.from({ length: rows + 1 }, (_, row) => reader.take(row));
  const corner = [reader.signed(), reader.signed(), reader.signed()],
    bits = reader.u8(),
    code = reader.rest();
  if (bits > MAX_POSITION_BITS || bits % 3 || corner.some((value) => Math.abs(value) > MAX_COORD))
    throw new BitstreamError(`positions: ${bits} bits or the corner are out of range`);
  if (count > 8 * code.length) throw new BitstreamError(`positions: ${code.length} bytes cannot hold ${count} anchors`);
  const tree = decodeTreePositions(new RangeDecoder(code), count, bits, leaf);
  if (
    tree.numLowBits.some((numLowBits) => Math.ceil(numLowBits / 3) > rows) ||
    stopProbabilities.some((row) => row.includes(0))
  )
    throw new BitstreamError("positions: probabilities are missing or 0");
  return { corner, bits, stopProbabilities, ...tree };
}

type Tree = Pick<Positions, "upperBits" | "numLowBits" | "leafSize" | "leafIndex">;

function decodeTreePositions(coder: RangeDecoder, count: number, bits: number, leaf: number): Tree {
  const upperBits = new Int32Array(3 * count),
    numLowBits = new Uint8Array(count),
    leafSize = new Uint8Array(count),
    leafIndex = new Uint8Array(count);
  decodeTree(coder, new Int32Array(2 * TREE_CONTEXTS).fill(32768), count, bits, 0, leaf, (begin, end, bit, prefix) => {
    for (let i = begin; i < end; i++) {
      for (let a = 0; a < 3; a++) upperBits[3 * i + a] = prefix[a];
      numLowBits[i] = bit + 1;
      leafSize[i] = end - begin;
      leafIndex[i] = i - begin;
    }
  });
  return { upperBits, numLowBits, leafSize, leafIndex };
}

/**
 * Decodes the positions of some anchors. Their lower bits are at the beginning of a packet. Any bytes give some
 * positions.
 */
export function decodePositions(coder: RangeDecoder, positions: Positions, ranks: Int32Array): Int32Array {
  const voxels = new Int32Array(3 * ranks.length);
  ranks.forEach((rank, n) => {
    voxels.set(positions.upperBits.subarray(3 * rank, 3 * rank + 3), 3 * n);
    decodeLowBits(coder, positions, positions.numLowBits[rank], voxels, 3 * n);
  });
  return voxels;
}

/** Decodes the lowest bits of one code: the number of zero triples at the end, then the other bits uncoded. */
function decodeLowBits(
  coder: RangeDecoder,
  { stopProbabilities }: Positions,
  numLowBits: number,
  voxels: Int32Array,
  at: number,
): void {
  const threes = Math.ceil(numLowBits / 3);
  let bit = numLowBits - 1,
    zeros = 0;
  const append = (value: number, count: number): void => {
    for (let i = count - 1; i >= 0; i--, bit--)
      voxels[at + (bit % 3)] = 2 * voxels[at + (bit % 3)] + ((value >> i) & 1);
  };
  while (zeros < threes) {
    const stop = stopProbabilities[threes][zeros];
    if (coder.target(256) < stop) {
      coder.advance(0, stop, 256);
      break;
    }
    coder.advance(stop, 256 - stop, 256);
    zeros++;
  }
  if (zeros < threes) {
    const rest = numLowBits - 3 * zeros,
      low = Math.min(rest, 3);
    for (let left = rest - low; left > 0; ) {
      const some = Math.min(left, 16);
      append(coder.raw(some), some);
      left -= some;
    }
    append(low > 1 ? 1 + coder.below(2 ** low - 1) : 1, low);
  }
  while (bit >= 0) append(0, 1);
}

/** Returns the predicted position of a lost anchor. Anchors of one leaf are spread evenly over it. */
export function predictedPosition({ upperBits, numLowBits, leafSize, leafIndex }: Positions, rank: number): Int32Array {
  const place = upperBits.slice(3 * rank, 3 * rank + 3),
    n = leafSize[rank],
    size = n > 1 ? 32 - Math.clz32(n - 1) : 0;
  const guess = Math.floor((leafIndex[rank] * 2 ** size) / n) * 8 + 7;
  for (let bit = numLowBits[rank] - 1, i = size + 2; bit >= 0; bit--, i--)
    place[bit % 3] = 2 * place[bit % 3] + (i >= 0 ? (guess >> i) & 1 : 0);
  return place;
}
