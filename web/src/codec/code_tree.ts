// Decoder of sorted Morton codes, stored as the counts of a binary space partition.

import type { RangeDecoder } from "../entropy/decoder.ts";

const RUNS = 4,
  SIZES = 8,
  FIELDS = 7,
  DEEPEST = 66;
/** Contexts of the flag that all codes of a node have the same next bit. */
export const TREE_CONTEXTS = RUNS * SIZES;

/**
 * Callback with the codes `begin` to `end - 1` of a leaf. `prefix` has the bits above `bit` of their three coordinates.
 */
type LeafCallback = (begin: number, end: number, bit: number, prefix: Int32Array) => void;

/**
 * Decodes the bits `bits - 1` down to `lowest` of Morton codes. Bit 0 belongs to x, bit 1 to y, bit 2 to z, bit 3 to x
 * again. Nodes of at most `leaf` codes are not split.
 */
export function decodeTree(
  coder: RangeDecoder,
  models: Int32Array,
  count: number,
  bits: number,
  lowest: number,
  leaf: number,
  onLeaf: LeafCallback,
): void {
  const stack = new Int32Array(DEEPEST * FIELDS),
    prefix = new Int32Array(3);
  const push = (top: number, begin: number, end: number, bit: number, run: number): void => {
    const at = top * FIELDS;
    stack[at] = begin;
    stack[at + 1] = end;
    stack[at + 2] = bit;
    stack[at + 3] = run;
    for (let a = 0; a < 3; a++) stack[at + 4 + a] = prefix[a];
  };
  push(0, 0, count, bits - 1, 0);
  for (let top = 0; top >= 0; top--) {
    const at = top * FIELDS,
      begin = stack[at],
      end = stack[at + 1],
      bit = stack[at + 2],
      run = stack[at + 3],
      n = end - begin;
    if (n === 0) continue;
    for (let a = 0; a < 3; a++) prefix[a] = stack[at + 4 + a];
    if (bit < lowest || n <= leaf) {
      onLeaf(begin, end, bit, prefix);
      continue;
    }
    const together = coder.bit(models, (Math.min(31 - Math.clz32(n), SIZES) - 1) * RUNS + run);
    const zeros = together ? (coder.raw(1) ? n : 0) : 1 + below(coder, n - 1);
    const next = together ? Math.min(run + 1, RUNS - 1) : 0,
      axis = bit % 3;
    prefix[axis] = 2 * prefix[axis] + 1;
    push(top, begin + zeros, end, bit - 1, next);
    prefix[axis] -= 1;
    push(top + 1, begin, begin + zeros, bit - 1, next);
    top += 2;
  }
}

/** Decodes a uniform integer below `count`. The lowest bits are coded separately if `count` is above 2^16. */
function below(coder: RangeDecoder, count: number): number {
  const shift = Math.max(32 - Math.clz32(count - 1) - 16, 0),
    high = coder.below(((count - 1) >> shift) + 1);
  return Math.min(high * 2 ** shift + coder.raw(shift), count - 1);
}
