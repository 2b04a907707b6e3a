// The first grid of a packet: in which cell each of its Gaussians lies, as the counts of a binary space partition.

import type { RangeDecoder } from "../../entropy/decoder.ts";

const RUNS = 4, FIELDS = 7, DEEPEST = 66;

/** Fills `cells` (3 each) with places of `depth` bits to an axis, in the order of their Morton codes. */
export function decodeCells(coder: RangeDecoder, models: Int32Array, cells: Int32Array, depth: number): void {
  const stack = new Int32Array(DEEPEST * FIELDS);
  stack.set([0, cells.length / 3, 3 * depth - 1, 0, 0, 0, 0]);
  for (let top = 0; top >= 0; top--) {
    const [begin, end, bit, run, x, y, z] = stack.subarray(top * FIELDS, (top + 1) * FIELDS);
    if (begin === end) continue;
    const prefix = [x, y, z];
    if (bit < 0 || end - begin === 1) {
      readBits(coder, prefix, bit);
      for (let i = begin; i < end; i++) for (let a = 0; a < 3; a++) cells[3 * i + a] = prefix[a];
      continue;
    }
    const n = end - begin, size = Math.min(31 - Math.clz32(n), 8);
    const together = coder.bit(models, (size - 1) * RUNS + run);
    const zeros = together ? (coder.raw(1) ? n : 0) : 1 + coder.below(n - 1);
    const next = together ? Math.min(run + 1, RUNS - 1) : 0, axis = bit % 3;
    prefix[axis] *= 2;
    stack.set([begin, begin + zeros, bit - 1, next, ...prefix], (top + 1) * FIELDS);
    prefix[axis] += 1;
    stack.set([begin + zeros, end, bit - 1, next, ...prefix], top * FIELDS);
    top += 2;
  }
}

/** The rest of a lone Gaussian's code, as it is: at most 16 bits at a time, the high ones first. */
function readBits(coder: RangeDecoder, prefix: number[], bit: number): void {
  while (bit >= 0) {
    const some = Math.min(bit + 1, 16), part = coder.raw(some);
    for (let i = some - 1; i >= 0; i--, bit--) prefix[bit % 3] = prefix[bit % 3] * 2 + ((part >> i) & 1);
  }
}
