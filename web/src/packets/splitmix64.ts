// SplitMix64 in two 32-bit halves. It assigns elements to the lanes of a block.

/** High half of the last result of `splitmixLow`, which thus makes no garbage: plans need one for each element. */
let resultHigh = 0;

/** Returns the low half of the generator's first output for a seed; `resultHigh` has the high half. */
function splitmixLow(seedLow: number, seedHigh: number): number {
  let low = seedLow + 0x7f4a7c15,
    high = (seedHigh + 0x9e3779b9 + (low >= 2 ** 32 ? 1 : 0)) | 0;
  low = multiply(low ^ ((low >>> 30) | (high << 2)), high ^ (high >>> 30), 0x1ce4e5b9, 0xbf58476d);
  high = resultHigh;
  low = multiply(low ^ ((low >>> 27) | (high << 5)), high ^ (high >>> 27), 0x133111eb, 0x94d049bb);
  high = resultHigh;
  resultHigh = (high ^ (high >>> 31)) >>> 0;
  return (low ^ ((low >>> 31) | (high << 1))) >>> 0;
}

/** Multiplies two 64-bit integers modulo 2^64. Returns the low half; `resultHigh` has the high half. */
function multiply(aLow: number, aHigh: number, bLow: number, bHigh: number): number {
  const a0 = aLow & 0xffff,
    a1 = aLow >>> 16,
    b0 = bLow & 0xffff,
    b1 = bLow >>> 16;
  const middle = a1 * b0 + (Math.imul(a0, b0) >>> 16),
    other = (middle & 0xffff) + a0 * b1;
  const carry = a1 * b1 + Math.floor(middle / 65536) + Math.floor(other / 65536);
  resultHigh = (carry + Math.imul(aLow, bHigh) + Math.imul(aHigh, bLow)) | 0;
  return Math.imul(aLow, bLow);
}

/** Returns the first output of the generator for a seed: low and high half. */
export function splitmix(seedLow: number, seedHigh: number): [number, number] {
  const low = splitmixLow(seedLow, seedHigh);
  return [low, resultHigh];
}

/** Returns that output modulo `count`, which is at most 2^16. */
export function splitmixModulo(seedLow: number, seedHigh: number, count: number): number {
  const low = splitmixLow(seedLow, seedHigh);
  return ((resultHigh % count) * (2 ** 32 % count) + (low % count)) % count;
}
