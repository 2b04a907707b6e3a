// Sorted Morton codes as the counts of a binary space partition, down to small nodes.

import type { RangeDecoder } from "../entropy/decoder.ts";

const RUNS = 4,
  SIZES = 8,
  FIELDS = 7,
  DEEPEST = 66;
/** Contexts of the bit that all codes of a node agree in the next bit, too. */
export const TREE_CONTEXTS = RUNS * SIZES;

/** What is known of codes `begin` to `end - 1`: the coordinates' bits above `bit`. */
type Found = (begin: number, end: number, bit: number, prefix: Int32Array) => void;

/**
 * Bits `bits - 1` to `lowest` of codes, whose lowest bit is that of x, then come y, z and the next of x; nodes of at
 * most `leaf` codes are not split.
 */
export function decodeTree(
  coder: RangeDecoder,
  models: Int32Array,
  count: number,
  bits: number,
  lowest: number,
  leaf: number,
  found: Found,
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
      found(begin, end, bit, prefix);
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

/** A number below `count`; of more than 2^16 the lowest bits are coded as they are. */
function below(coder: RangeDecoder, count: number): number {
  const shift = Math.max(32 - Math.clz32(count - 1) - 16, 0),
    high = coder.below(((count - 1) >> shift) + 1);
  return Math.min(high * 2 ** shift + coder.raw(shift), count - 1);
}
