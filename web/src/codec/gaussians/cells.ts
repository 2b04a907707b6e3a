// Coarse grid of a packet: the cell of each Gaussian, stored as the counts of a binary space partition.

import type { RangeDecoder } from "../../entropy/decoder.ts";
import { decodeTree } from "../code_tree.ts";
import { SLOT_BITS } from "./layout.ts";

/**
 * Decodes cells, shape (count, 3), of `depth` bits per axis. In a spread packet the lowest bits of the Morton codes are
 * nearly equal; these slots follow the tree of the other bits.
 */
export function decodeCells(coder: RangeDecoder, models: Int32Array, cells: Int32Array, depth: number): void {
  const spread = coder.raw(1),
    size = spread ? Math.min(3 * depth, SLOT_BITS) : 0;
  const first = coder.raw(size),
    count = coder.raw(size) + 1;
  decodeTree(coder, models, cells.length / 3, 3 * depth, size, 1, (begin, end, bit, prefix) => {
    readBits(coder, prefix, bit, size);
    for (let i = 3 * begin; i < 3 * end; i++) cells[i] = prefix[i % 3];
  });
  if (!spread) return;
  for (let i = 0; i < cells.length; i += 3) {
    const slot = first + coder.below(count);
    for (let b = size - 1; b >= 0; b--) cells[i + (b % 3)] = cells[i + (b % 3)] * 2 + ((slot >> (size - 1 - b)) & 1);
  }
}

/** Decodes the remaining bits of a single Gaussian uncoded, at most 16 at a time, high bits first. */
function readBits(coder: RangeDecoder, prefix: Int32Array, bit: number, lowest: number): void {
  while (bit >= lowest) {
    const some = Math.min(bit - lowest + 1, 16),
      part = coder.raw(some);
    for (let i = some - 1; i >= 0; i--, bit--) prefix[bit % 3] = prefix[bit % 3] * 2 + ((part >> i) & 1);
  }
}
