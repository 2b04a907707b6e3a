// SplitMix64 in two 32-bit halves. It assigns elements to the lanes of a block.

/** High half of the last result, in an array because engines allocate a number for each 32-bit value of a variable. */
const HIGH = new Int32Array(1);

/** Returns the low half of the generator's first output for a seed, as a signed integer; `HIGH` has the high half. */
function splitmixLow(seedLow: number, seedHigh: number): number {
  let low = (seedLow + 0x7f4a7c15) | 0,
    high = (seedHigh + 0x9e3779b9 + (low >>> 0 < 0x7f4a7c15 ? 1 : 0)) | 0;
  low = multiply(low ^ ((low >>> 30) | (high << 2)), high ^ (high >>> 30), 0x1ce4e5b9, 0xbf58476d | 0);
  high = HIGH[0];
  low = multiply(low ^ ((low >>> 27) | (high << 5)), high ^ (high >>> 27), 0x133111eb, 0x94d049bb | 0);
  high = HIGH[0];
  HIGH[0] = high ^ (high >>> 31);
  return low ^ ((low >>> 31) | (high << 1));
}

/** Multiplies two 64-bit integers modulo 2^64. Returns the low half; `HIGH` has the high half. */
function multiply(aLow: number, aHigh: number, bLow: number, bHigh: number): number {
  const a0 = aLow & 0xffff,
    a1 = aLow >>> 16,
    b0 = bLow & 0xffff,
    b1 = bLow >>> 16;
  // products of 16 bits, plus at most two numbers of 16 bits, are below 2^32
  const middle = (Math.imul(a1, b0) + (Math.imul(a0, b0) >>> 16)) | 0,
    other = ((middle & 0xffff) + Math.imul(a0, b1)) | 0,
    carry = Math.imul(a1, b1) + (middle >>> 16) + (other >>> 16);
  HIGH[0] = carry + Math.imul(aLow, bHigh) + Math.imul(aHigh, bLow);
  return Math.imul(aLow, bLow);
}

/** Returns the first output of the generator for a seed: low and high half. */
export function splitmix(seedLow: number, seedHigh: number): [number, number] {
  const low = splitmixLow(seedLow, seedHigh);
  return [low >>> 0, HIGH[0] >>> 0];
}

/** Returns that output modulo `count`, which is at most 2^16. All operands have 32 bits, which engines divide fast. */
export function splitmixModulo(seedLow: number, seedHigh: number, count: number): number {
  const low = splitmixLow(seedLow, seedHigh) >>> 0,
    wrap = ((0xffffffff % count) + 1) % count, // 2^32
    high = (((HIGH[0] >>> 0) % count) * wrap) >>> 0;
  return ((high % count) + (low % count)) % count;
}
