// Conversion of motion coefficients to offsets. It is the floating-point end of the motion decoder.

import { BITS, DIRECTION_BITS } from "../gaussians/layout.ts";
import type { Splats } from "../splats.ts";
import { KIND_OF, NUM_CHANNELS } from "./layout.ts";
import type { SequenceInfo } from "./side_info.ts";

const TABLES = new Map<number, Float64Array>();
const MAX_OPACITY = 1 - 1e-6,
  MAX_FLOAT = 3.4028234663852886e38;

/**
 * Returns orthonormal discrete Legendre polynomials over equally spaced frames, shape (frames, frames). The second
 * index is the degree.
 */
export function polynomials(frames: number): Float64Array {
  const known = TABLES.get(frames);
  if (known) return known;
  const table = new Float64Array(frames * frames),
    at = (frame: number, degree: number): number => table[frame * frames + degree];
  for (let k = 0; k < frames; k++) {
    const column = Float64Array.from({ length: frames }, (_, f) =>
      k ? (frames > 1 ? (2 * f) / (frames - 1) - 1 : 0) * at(f, k - 1) : 1,
    );
    for (let again = 0; again < 2; again++) {
      for (let j = 0; j < k; j++) {
        let dot = 0;
        for (let f = 0; f < frames; f++) dot += column[f] * at(f, j);
        for (let f = 0; f < frames; f++) column[f] -= dot * at(f, j);
      }
    }
    const norm = Math.sqrt(column.reduce((sum, value) => sum + value * value, 0));
    for (let f = 0; f < frames; f++) table[f * frames + k] = column[f] / norm;
  }
  TABLES.set(frames, table);
  return table;
}

/** Returns the unit of each channel: world units, tangents, natural logarithms, colours. */
export function unitsOf({ keyframeInfo }: SequenceInfo): Float64Array {
  const place = 2 ** (keyframeInfo.sizeLog - keyframeInfo.latticeBits - 1),
    rotate = 2 ** -DIRECTION_BITS,
    log = Math.LN2 / 2 ** BITS,
    colour = 2 ** -BITS;
  return Float64Array.from([place, place, place, rotate, rotate, rotate, log, log, log, log, colour, colour, colour]);
}

const R2 = Math.sqrt(2),
  R3 = Math.sqrt(3),
  R6 = Math.sqrt(6);

/**
 * Computes the offsets of a track in each frame from its coefficients from index `from`. Writes them to `out` from
 * index `to`. Its frames are `stride` numbers apart.
 *
 * Channels: position (world units), rotation, natural logarithms of the scales and of opacity, RGB. The rotation is a
 * vector along the axis of length 4 tan(angle / 4).
 */
export function offsetsOf(
  coefficients: Float64Array,
  from: number,
  frames: number,
  numCoefficients: Int32Array,
  units: Float64Array,
  out: Float32Array,
  to: number,
  stride: number,
): void {
  const table = polynomials(frames);
  for (let c = 0, own = from; c < NUM_CHANNELS; own += numCoefficients[KIND_OF[c++]]) {
    const unit = units[c];
    let end = numCoefficients[KIND_OF[c]];
    while (end && !coefficients[own + end - 1]) end--;
    if (!end) continue;
    for (let f = 0, row = 0; f < frames; f++, row += frames) {
      let sum = 0;
      for (let k = 0; k < end; k++) sum += coefficients[own + k] * table[row + k];
      out[to + f * stride + c] = sum * unit;
    }
  }
  if (!numCoefficients[KIND_OF[NUM_CHANNELS - 1]]) return;
  for (let f = 0; f < frames; f++) {
    const at = to + f * stride;
    const y = out[at + 10],
      co = out[at + 11],
      cg = out[at + 12];
    out[at + 10] = y / R3 + co / R2 - cg / R6;
    out[at + 11] = y / R3 + (2 * cg) / R6;
    out[at + 12] = y / R3 - co / R2 - cg / R6;
  }
}

/**
 * Moves the Gaussians of some rows and writes them to `out` from index `to` on. `arrivalIndices` are the indices of
 * all rows in `splats`. `offsets` has shape (tracks, channels), and belongs to the rows from `first` on.
 */
export function moveRows(
  splats: Splats,
  arrivalIndices: Int32Array,
  rows: Int32Array,
  offsets: Float32Array,
  first: number,
  out: Splats,
  to: number,
): void {
  const { means, quats, scales, opacities, colours, harmonics } = out,
    { means: centers, scales: sizes, colours: shades, quats: turns } = splats,
    width = 3 * ((splats.degree + 1) ** 2 - 1);
  for (const row of rows) {
    const arrivalIndex = arrivalIndices[row],
      at = NUM_CHANNELS * (row - first);
    for (let a = 0, i = 3 * arrivalIndex, n = 3 * to; a < 3; a++, i++, n++) {
      means[n] = centers[i] + offsets[at + a];
      scales[n] = changed(sizes[i], offsets[at + 6 + a], MAX_FLOAT);
      colours[n] = shades[i] + offsets[at + 10 + a];
    }
    opacities[to] = changed(splats.opacities[arrivalIndex], offsets[at + 9], MAX_OPACITY);
    for (let k = 0; k < width; k++) harmonics[width * to + k] = splats.harmonics[width * arrivalIndex + k];
    turn(turns, 4 * arrivalIndex, offsets, at + 3, quats, 4 * to++);
  }
}

/** Returns a value whose logarithm changes by `change`, which is often 0; at most `most` for any bytes in a packet. */
const changed = (value: number, change: number, most: number): number =>
  Math.min(change ? value * Math.exp(change) : value, most);

function turn(quats: Float32Array, q: number, offsets: Float32Array, r: number, out: Float32Array, to: number): void {
  const x = offsets[r] / 4,
    y = offsets[r + 1] / 4,
    z = offsets[r + 2] / 4,
    square = x * x + y * y + z * z,
    part = 2 / (1 + square),
    w = (1 - square) / (1 + square),
    i = x * part,
    j = y * part,
    k = z * part,
    a = quats[q],
    b = quats[q + 1],
    c = quats[q + 2],
    d = quats[q + 3];
  out[to] = w * a - i * b - j * c - k * d;
  out[to + 1] = w * b + i * a + j * d - k * c;
  out[to + 2] = w * c - i * d + j * a + k * b;
  out[to + 3] = w * d + i * c - j * b + k * a;
}
