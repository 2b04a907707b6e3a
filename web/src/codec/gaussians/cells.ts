// The first grid of a packet: in which cell each of its Gaussians lies, as the counts of a binary space partition.

import type { RangeDecoder } from "../../entropy/decoder.ts";
import { SLOT_BITS } from "./layout.ts";

const RUNS = 4, FIELDS = 7, DEEPEST = 66;

/**
 * Fills `cells` (3 each) with places of `depth` bits to an axis. A spread packet holds cells that agree, but for a few bits, in the
 * lowest bits of their Morton codes: these slots follow the tree of the other bits.
 */
export function decodeCells(coder: RangeDecoder, models: Int32Array, cells: Int32Array, depth: number): void {
  const spread = coder.raw(1), size = spread ? Math.min(3 * depth, SLOT_BITS) : 0;
  const first = coder.raw(size), count = coder.raw(size) + 1;
  decodeTree(coder, models, cells, 3 * depth, size);
  if (!spread) return;
  for (let i = 0; i < cells.length; i += 3) {
    const slot = first + coder.below(count);
    for (let b = size - 1; b >= 0; b--) cells[i + (b % 3)] = cells[i + (b % 3)] * 2 + ((slot >> (size - 1 - b)) & 1);
  }
}

/** All bits of the codes but the lowest, as the counts of a binary space partition. */
function decodeTree(coder: RangeDecoder, models: Int32Array, cells: Int32Array, bits: number, lowest: number): void {
  const stack = new Int32Array(DEEPEST * FIELDS), prefix = new Int32Array(3);
  const push = (top: number, begin: number, end: number, bit: number, run: number): void => {
    const at = top * FIELDS;
    stack[at] = begin;
    stack[at + 1] = end;
    stack[at + 2] = bit;
    stack[at + 3] = run;
    for (let a = 0; a < 3; a++) stack[at + 4 + a] = prefix[a];
  };
  push(0, 0, cells.length / 3, bits - 1, 0);
  for (let top = 0; top >= 0; top--) {
    const at = top * FIELDS, begin = stack[at], end = stack[at + 1], bit = stack[at + 2], run = stack[at + 3], n = end - begin;
    if (n === 0) continue;
    for (let a = 0; a < 3; a++) prefix[a] = stack[at + 4 + a];
    if (bit < lowest || n === 1) {
      readBits(coder, prefix, bit, lowest);
      for (let i = 3 * begin; i < 3 * end; i++) cells[i] = prefix[i % 3];
      continue;
    }
    const together = coder.bit(models, (Math.min(31 - Math.clz32(n), 8) - 1) * RUNS + run);
    const zeros = together ? (coder.raw(1) ? n : 0) : 1 + coder.below(n - 1);
    const next = together ? Math.min(run + 1, RUNS - 1) : 0, axis = bit % 3;
    prefix[axis] = 2 * prefix[axis] + 1;
    push(top, begin + zeros, end, bit - 1, next);
    prefix[axis] -= 1;
    push(top + 1, begin, begin + zeros, bit - 1, next);
    top += 2;
  }
}

/** The rest of a lone Gaussian's bits, as they are: at most 16 at a time, the high ones first. */
function readBits(coder: RangeDecoder, prefix: Int32Array, bit: number, lowest: number): void {
  while (bit >= lowest) {
    const some = Math.min(bit - lowest + 1, 16), part = coder.raw(some);
    for (let i = some - 1; i >= 0; i--, bit--) prefix[bit % 3] = prefix[bit % 3] * 2 + ((part >> i) & 1);
  }
}
