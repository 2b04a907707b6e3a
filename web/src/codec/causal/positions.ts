// Places of anchors: the head has the upper bits of their Morton codes as counts of a binary space partition, packets
// the rest.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { RangeDecoder } from "../../entropy/decoder.ts";
import { MAX_LEAF, MAX_PLACE, MAX_POSITION_BITS } from "../../packets/limits.ts";
import { decodeTree, TREE_CONTEXTS } from "../code_tree.ts";

const MAX_ROWS = MAX_POSITION_BITS / 3;

/** What the head says of the places of all anchors, by rank; coordinates are voxels from `origin`. */
export interface Positions {
  readonly origin: readonly number[];
  /** Bits of a code: the lowest is the lowest of x, then of y, of z, the next of x. */
  readonly bits: number;
  /** Coordinates without the bits that are not known yet, three each. */
  readonly known: Int32Array;
  /** How many of a code's bits are in its packet. */
  readonly below: Uint8Array;
  /** How many anchors the same is known of, and the number of this one among them. */
  readonly alike: Uint8Array;
  readonly among: Uint8Array;
  /** How probable it is, out of 2^8, that no bit above the n-th three is 1, by how many threes there are. */
  readonly stops: readonly Uint8Array[];
}

export function readPositions(bytes: Uint8Array, count: number): Positions {
  const reader = new ByteReader(bytes, "positions"),
    leaf = reader.u8(),
    rows = reader.u8();
  if (leaf < 1 || leaf > MAX_LEAF || rows > MAX_ROWS)
    throw new BitstreamError(`positions: nodes of ${leaf} anchors, ${rows} rows of chances`);
  const stops = Array.from({ length: rows + 1 }, (_, row) => reader.take(row));
  const origin = [reader.signed(), reader.signed(), reader.signed()],
    bits = reader.u8(),
    code = reader.rest();
  if (bits > MAX_POSITION_BITS || bits % 3 || origin.some((value) => Math.abs(value) > MAX_PLACE))
    throw new BitstreamError(`positions: an impossible extent of ${bits} bits`);
  if (count > 8 * code.length) throw new BitstreamError(`positions: ${code.length} bytes cannot hold ${count} anchors`);
  const tree = knownPlaces(new RangeDecoder(code), count, bits, leaf);
  if (tree.below.some((below) => Math.ceil(below / 3) > rows) || stops.some((row) => row.includes(0)))
    throw new BitstreamError("positions: chances are missing");
  return { origin, bits, stops, ...tree };
}

type Tree = Pick<Positions, "known" | "below" | "alike" | "among">;

function knownPlaces(coder: RangeDecoder, count: number, bits: number, leaf: number): Tree {
  const known = new Int32Array(3 * count),
    below = new Uint8Array(count),
    alike = new Uint8Array(count),
    among = new Uint8Array(count);
  decodeTree(coder, new Int32Array(2 * TREE_CONTEXTS).fill(32768), count, bits, 0, leaf, (begin, end, bit, prefix) => {
    for (let i = begin; i < end; i++) {
      for (let a = 0; a < 3; a++) known[3 * i + a] = prefix[a];
      below[i] = bit + 1;
      alike[i] = end - begin;
      among[i] = i - begin;
    }
  });
  return { known, below, alike, among };
}

/** Coordinates of some anchors, whose lower bits come first in their packet; any bytes give some. */
export function decodePlaces(coder: RangeDecoder, positions: Positions, ranks: Int32Array): Int32Array {
  const places = new Int32Array(3 * ranks.length);
  ranks.forEach((rank, n) => {
    places.set(positions.known.subarray(3 * rank, 3 * rank + 3), 3 * n);
    decodeRest(coder, positions, positions.below[rank], places, 3 * n);
  });
  return places;
}

/** The lowest bits of one code: zeros at its end are told in threes, then come the others as they are. */
function decodeRest(coder: RangeDecoder, { stops }: Positions, below: number, places: Int32Array, at: number): void {
  const threes = Math.ceil(below / 3);
  let bit = below - 1,
    zeros = 0;
  const append = (value: number, count: number): void => {
    for (let i = count - 1; i >= 0; i--, bit--)
      places[at + (bit % 3)] = 2 * places[at + (bit % 3)] + ((value >> i) & 1);
  };
  while (zeros < threes) {
    const stop = stops[threes][zeros];
    if (coder.target(256) < stop) {
      coder.advance(0, stop, 256);
      break;
    }
    coder.advance(stop, 256 - stop, 256);
    zeros++;
  }
  if (zeros < threes) {
    const rest = below - 3 * zeros,
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

/** Where an anchor is expected whose packet has not come: those of which the same is known lie side by side. */
export function expectedPlace({ known, below, alike, among }: Positions, rank: number): Int32Array {
  const place = known.slice(3 * rank, 3 * rank + 3),
    n = alike[rank],
    size = n > 1 ? 32 - Math.clz32(n - 1) : 0;
  const guess = Math.floor((among[rank] * 2 ** size) / n) * 8 + 7;
  for (let bit = below[rank] - 1, i = size + 2; bit >= 0; bit--, i--)
    place[bit % 3] = 2 * place[bit % 3] + (i >= 0 ? (guess >> i) & 1 : 0);
  return place;
}
