// SplitMix64 in two halves of 32 bits: which lane of a block an element rides in.

const low16 = (x: number): number => x & 0xffff;

/** Low and high half of a product of two 64-bit numbers, modulo 2^64. */
function multiply(aLow: number, aHigh: number, bLow: number, bHigh: number): [number, number] {
  const a0 = low16(aLow),
    a1 = aLow >>> 16,
    b0 = low16(bLow),
    b1 = bLow >>> 16;
  const middle = a1 * b0 + Math.floor((a0 * b0) / 65536);
  const other = low16(middle) + a0 * b1;
  const low = Math.imul(aLow, bLow) >>> 0;
  const carry = a1 * b1 + Math.floor(middle / 65536) + Math.floor(other / 65536);
  return [low, (carry + Math.imul(aLow, bHigh) + Math.imul(aHigh, bLow)) >>> 0];
}

function shiftXor(low: number, high: number, by: number): [number, number] {
  return [(low ^ ((low >>> by) | (high << (32 - by)))) >>> 0, (high ^ (high >>> by)) >>> 0];
}

/** The first output of the generator seeded with a number: low and high half. */
export function splitmix(seedLow: number, seedHigh: number): [number, number] {
  let low = seedLow + 0x7f4a7c15;
  let high = (seedHigh + 0x9e3779b9 + (low >= 2 ** 32 ? 1 : 0)) >>> 0;
  low >>>= 0;
  [low, high] = shiftXor(low, high, 30);
  [low, high] = multiply(low, high, 0x1ce4e5b9, 0xbf58476d);
  [low, high] = shiftXor(low, high, 27);
  [low, high] = multiply(low, high, 0x133111eb, 0x94d049bb);
  return shiftXor(low, high, 31);
}

/** That output modulo `count`, at most 2^16. */
export function splitmixModulo(seedLow: number, seedHigh: number, count: number): number {
  const [low, high] = splitmix(seedLow, seedHigh);
  return ((high % count) * (2 ** 32 % count) + (low % count)) % count;
}
