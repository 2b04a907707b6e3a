// Reconstructs the coefficients of a packet's tracks from residuals. The prediction is a least-squares plane through
// the nearest neighbours in the packet. All numbers stay below 2^53.

import { KIND_OF, MAX_COEFFICIENT, NUM_CHANNELS, NUM_NEIGHBOURS, POSITION_BITS, WEIGHT } from "./layout.ts";

const RADIUS = 1 << 10,
  MAX_MOMENT = 2 ** 16,
  MAX_SOLUTION = 2 ** 33,
  RIDGE = 2 ** 14,
  MIN_RIDGE = 4,
  TILT_UNIT = 2 ** 20;

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);

/** Returns the number of coefficients of a track, all channels together. */
export function totalCoefficients(numCoefficients: Int32Array): number {
  let total = 0;
  for (let c = 0; c < NUM_CHANNELS; c++) total += numCoefficients[KIND_OF[c]];
  return total;
}

/**
 * Buffer for the result. It grows with the largest packet and is reused because packets are processed one after
 * another.
 */
let buffer = new Float64Array(0);

/**
 * Returns the coefficients, one row per track; 0 for tracks that do not move. The result is valid until the next call.
 *
 * @param positions Positions of the keyframe Gaussians, units of motion, shape (n, 3).
 * @param moving Moving tracks (1), shape (n).
 * @param shifts log2 of the steps, shape (n, channels).
 * @param residuals Residuals in steps, shape (n, channels, F).
 * @param numCoefficients Number of coefficients per kind of channel.
 */
export function coefficients(
  positions: Float64Array,
  moving: Uint8Array,
  shifts: Int32Array,
  residuals: Int32Array,
  numCoefficients: Int32Array,
): Float64Array {
  const count = moving.length,
    frames = residuals.length / NUM_CHANNELS / Math.max(count, 1),
    size = totalCoefficients(numCoefficients),
    normalised = normalisedPositions(positions),
    known = new Int32Array(count),
    means = new Float64Array(size),
    plane = new Plane(normalised);
  if (buffer.length < count * size) buffer = new Float64Array(count * size);
  const out = buffer.subarray(0, count * size).fill(0);
  let numKnown = 0;
  for (let i = 0; i < count; i++) if (!moving[i]) known[numKnown++] = i;
  for (const i of predictionOrder(normalised, moving, shifts)) {
    plane.fit(known, numKnown, i);
    const row = i * size;
    weightedMeans(plane, moving, out, means);
    for (let c = 0, u = 0; c < NUM_CHANNELS; c++) {
      const end = numCoefficients[KIND_OF[c]],
        step = end ? 2 ** shifts[i * NUM_CHANNELS + c] : 0;
      for (let k = 0, at = (i * NUM_CHANNELS + c) * frames; k < end; k++, at++, u++) {
        const value = Math.floor((means[u] + WEIGHT / 2) / WEIGHT) + residuals[at] * step;
        out[row + u] = clip(value, -MAX_COEFFICIENT, MAX_COEFFICIENT);
      }
    }
    known[numKnown++] = i;
  }
  return out;
}

/**
 * Writes the neighbours' weighted coefficients to `means`. Adds four neighbours per pass, so that each sum is read and
 * written once for them.
 */
function weightedMeans(
  { count, weights, indices }: Plane,
  moving: Uint8Array,
  rows: Float64Array,
  means: Float64Array,
): void {
  const size = means.fill(0).length,
    weightOf = (m: number): number => (m < count && moving[indices[m]] ? weights[m] : 0);
  for (let m = 0; m < count; m += 4) {
    const p = weightOf(m),
      q = weightOf(m + 1),
      r = weightOf(m + 2),
      s = weightOf(m + 3);
    if (!p && !q && !r && !s) continue;
    let a = indices[m] * size,
      b = indices[m + 1] * size,
      c = indices[m + 2] * size,
      d = indices[m + 3] * size;
    for (let u = 0; u < size; u++) means[u] += p * rows[a++] + q * rows[b++] + r * rows[c++] + s * rows[d++];
  }
}

/** Returns the positions relative to their lower corner, rounded to `POSITION_BITS` bits per axis. */
export function normalisedPositions(positions: Float64Array): Float64Array {
  const found = positions.slice();
  let extent = 0,
    unit = 1;
  for (let a = 0; a < 3; a++) {
    let low = Infinity;
    for (let n = a; n < positions.length; n += 3) low = Math.min(low, positions[n]);
    for (let n = a; n < positions.length; n += 3) extent = Math.max(extent, (found[n] -= low));
  }
  while (Math.floor(extent / unit) >= 2 ** POSITION_BITS) unit *= 2;
  for (let n = 0; n < found.length; n++) found[n] = Math.floor(found[n] / unit);
  return found;
}

/**
 * Returns the moving tracks in the order in which their motion is predicted: by step, then along a Z-order curve with
 * decreasing strides.
 */
export function predictionOrder(positions: Float64Array, moving: Uint8Array, shifts: Int32Array): Int32Array {
  const keys = new Float64Array(moving.length),
    tracks = new Int32Array(moving.length);
  let n = 0;
  for (let i = 0; i < moving.length; i++) {
    if (!moving[i]) continue;
    for (let a = 0; a < 3; a++) keys[n] += spreadBits(positions[3 * i + a] >> (POSITION_BITS - 10)) << a;
    tracks[n++] = i;
  }
  const alongCurve = sortedBy(keys, tracks, n),
    bits = n > 1 ? 32 - Math.clz32(n - 1) : 0;
  for (let slot = 0, at = 0; slot < 1 << bits; slot++) {
    let reversed = 0;
    for (let bit = 0; bit < bits; bit++) reversed |= ((slot >> bit) & 1) << (bits - 1 - bit);
    if (reversed >= n) continue;
    const i = (tracks[at] = alongCurve[reversed]);
    keys[at++] = (shifts[i * NUM_CHANNELS] + shifts[i * NUM_CHANNELS + 3]) >> 1;
  }
  return sortedBy(keys, tracks, n);
}

/** Returns the first `n` tracks by ascending key, an integer below 2^30. Equal keys keep their order. */
function sortedBy(keys: Float64Array, tracks: Int32Array, n: number): Int32Array {
  const unit = 2 ** 22, // larger than the number of tracks, so that sorting needs no function
    sorted = keys.subarray(0, n),
    found = new Int32Array(n);
  for (let i = 0; i < n; i++) sorted[i] = sorted[i] * unit + i;
  sorted.sort();
  for (let i = 0; i < n; i++) found[i] = tracks[sorted[i] % unit];
  return found;
}

/** Inserts two zero bits after each of ten bits. */
function spreadBits(bits: number): number {
  bits = (bits | (bits << 16)) & 0x030000ff;
  bits = (bits | (bits << 8)) & 0x0300f00f;
  bits = (bits | (bits << 4)) & 0x030c30c3;
  return (bits | (bits << 2)) & 0x09249249;
}

/** Weights of the nearest neighbours in the plane fit. They sum to `WEIGHT`. */
class Plane {
  count = 0;
  readonly indices = new Int32Array(NUM_NEIGHBOURS);
  readonly weights = new Float64Array(NUM_NEIGHBOURS);
  readonly #squaredDistances = new Float64Array(NUM_NEIGHBOURS);
  readonly #proximity = new Float64Array(NUM_NEIGHBOURS);
  readonly #offsets = new Float64Array(3 * NUM_NEIGHBOURS);

  constructor(readonly positions: Float64Array) {}

  fit(known: Int32Array, numKnown: number, i: number): void {
    this.#find(known, numKnown, i);
    const { count, weights } = this;
    weights.fill(Math.floor(WEIGHT / Math.max(count, 1)), 0, count);
    if (count >= 4) this.#plane(i);
    let left = WEIGHT;
    for (let m = 0; m < count; m++) left -= weights[m];
    if (count) weights[0] += left;
  }

  /** Finds the nearest tracks, nearest first. Among equal distances the earlier track counts. */
  #find(known: Int32Array, numKnown: number, i: number): void {
    const { positions, indices } = this,
      squaredDistances = this.#squaredDistances,
      x = positions[3 * i],
      y = positions[3 * i + 1],
      z = positions[3 * i + 2];
    let count = 0;
    for (let m = 0; m < numKnown; m++) {
      const j = known[m],
        dx = positions[3 * j] - x,
        dy = positions[3 * j + 1] - y,
        dz = positions[3 * j + 2] - z,
        d = dx * dx + dy * dy + dz * dz;
      if (count === NUM_NEIGHBOURS && d >= squaredDistances[count - 1]) continue;
      let at = count < NUM_NEIGHBOURS ? count++ : count - 1;
      for (; at > 0 && squaredDistances[at - 1] > d; at--) {
        squaredDistances[at] = squaredDistances[at - 1];
        indices[at] = indices[at - 1];
      }
      squaredDistances[at] = d;
      indices[at] = j;
    }
    this.count = count;
  }

  #plane(i: number): void {
    const { positions, indices, count, weights } = this,
      squaredDistances = this.#squaredDistances,
      proximity = this.#proximity,
      o = this.#offsets;
    let radius = 1,
      total = 0;
    for (let m = 0; m < count; m++)
      for (let a = 0; a < 3; a++)
        radius = Math.max(radius, Math.abs(positions[3 * indices[m] + a] - positions[3 * i + a]));
    let sx = 0,
      sy = 0,
      sz = 0,
      xx = 0,
      xy = 0,
      xz = 0,
      yy = 0,
      yz = 0,
      zz = 0;
    for (let m = 0; m < count; m++) {
      const w = (proximity[m] = 1 + Math.floor((2 * (squaredDistances[0] + 1)) / (squaredDistances[m] + 1)));
      for (let a = 0; a < 3; a++)
        o[3 * m + a] = Math.floor(((positions[3 * indices[m] + a] - positions[3 * i + a]) * RADIUS) / radius);
      const x = o[3 * m],
        y = o[3 * m + 1],
        z = o[3 * m + 2];
      total += w;
      sx += w * x;
      sy += w * y;
      sz += w * z;
      xx += w * x * x;
      xy += w * x * y;
      xz += w * x * z;
      yy += w * y * y;
      yz += w * y * z;
      zz += w * z * z;
    }
    xx = total * xx - sx * sx;
    xy = total * xy - sx * sy;
    xz = total * xz - sx * sz;
    yy = total * yy - sy * sy;
    yz = total * yz - sy * sz;
    zz = total * zz - sz * sz;
    const trace = xx + yy + zz;
    let momentDivisor = 1;
    while (Math.floor(trace / momentDivisor) >= MAX_MOMENT) momentDivisor *= 2;
    const ridge = Math.floor(trace / (momentDivisor * RIDGE)) + MIN_RIDGE;
    xx = Math.floor(xx / momentDivisor) + ridge;
    xy = Math.floor(xy / momentDivisor);
    xz = Math.floor(xz / momentDivisor);
    yy = Math.floor(yy / momentDivisor) + ridge;
    yz = Math.floor(yz / momentDivisor);
    zz = Math.floor(zz / momentDivisor) + ridge;
    const a = yy * zz - yz * yz,
      b = xz * yz - xy * zz,
      c = xy * yz - xz * yy,
      d = xx * zz - xz * xz,
      e = xy * xz - xx * yz,
      g = xx * yy - xy * xy,
      determinant = Math.max(xx * a + xy * b + xz * c, 1);
    let hx = a * sx + b * sy + c * sz,
      hy = b * sx + d * sy + e * sz,
      hz = c * sx + e * sy + g * sz,
      solutionDivisor = 1;
    const most = Math.max(Math.abs(hx), Math.abs(hy), Math.abs(hz));
    while (Math.floor(most / solutionDivisor) >= MAX_SOLUTION) solutionDivisor *= 2;
    hx = Math.floor(hx / solutionDivisor);
    hy = Math.floor(hy / solutionDivisor);
    hz = Math.floor(hz / solutionDivisor);
    const scale = (TILT_UNIT * solutionDivisor) / momentDivisor;
    for (let m = 0; m < count; m++) {
      const moment = hx * (total * o[3 * m] - sx) + hy * (total * o[3 * m + 1] - sy) + hz * (total * o[3 * m + 2] - sz),
        tilt = Math.floor((moment / determinant) * scale + 0.5),
        share = Math.floor((proximity[m] * (TILT_UNIT - tilt)) / (total * (TILT_UNIT / WEIGHT)));
      weights[m] = clip(share, -WEIGHT, WEIGHT);
    }
  }
}
