// Conversion of decoded integers to Gaussians. It is the last step and the only floating-point part of the codec.

import { DC, type Splats, splatsIn } from "../splats.ts";
import {
  AXIS,
  BITS,
  COLUMNS,
  ELONGATION,
  FLATNESS,
  LUMA,
  OPACITY,
  POSITION,
  PRIMARY,
  SCALE0,
  SPIN,
  SPIN_BITS,
  TRANSFORM_UNIT,
} from "./layout.ts";
import type { Decoded } from "./packet.ts";
import type { SideInfo } from "./side_info.ts";
import { flatnessTable } from "./tables.ts";

const R2 = Math.sqrt(2),
  R3 = Math.sqrt(3),
  R6 = Math.sqrt(6),
  UNIT = 2 ** BITS,
  SUMS = UNIT * TRANSFORM_UNIT;
/** Harmonics of one Gaussian, at most 15 per channel. */
const SUM = new Float64Array(45);

/** Powers of two of the integers of one octave, and of whole octaves from -`OCTAVES` on. */
const OCTAVES = 128;
export const FRACTIONS = Float64Array.from({ length: UNIT }, (_, i) => 2 ** (i / UNIT)),
  WHOLES = Float64Array.from({ length: 2 * OCTAVES }, (_, i) => 2 ** (i - OCTAVES));

/** Returns 2^(log / 2^BITS); all logarithms of decoded Gaussians are within 128 octaves. */
const powerOfTwo = (log: number): number => FRACTIONS[log & (UNIT - 1)] * WHOLES[(log >> BITS) + OCTAVES];

/** Converts orthonormal Y Co Cg to RGB. */
function rgb(y: number, co: number, cg: number, out: Float32Array, at: number): void {
  out[at] = y / R3 + co / R2 - cg / R6;
  out[at + 1] = y / R3 + (2 * cg) / R6;
  out[at + 2] = y / R3 - co / R2 - cg / R6;
}

/**
 * Converts the Gaussians of a packet to floating point. Writes them to `target`, which must be zero, or to new arrays.
 * A decoder with its own conversion has the same result, bit by bit.
 */
export function toSplats(decoded: Decoded, info: SideInfo, block: number, target?: Splats): Splats {
  const { splats } = decoded;
  if (splats && !target) return splats;
  if (splats && target) return copySplats(splats, target);
  return convert(decoded, info, block, target ?? splatsIn(decoded.rows.length / COLUMNS, info.degree));
}

function copySplats(from: Splats, to: Splats): Splats {
  for (const name of ["means", "quats", "scales", "opacities", "colours", "harmonics"] as const)
    to[name].set(from[name]);
  return to;
}

/** Converts integers to floating point. Writes the Gaussians to `splats`, which must be zero, and returns it. */
export function convert({ rows, harmonics }: Decoded, info: SideInfo, block: number, splats: Splats): Splats {
  const { count, means, scales, opacities, colours, quats } = splats,
    { numHarmonicColumns, transform } = info,
    numHarmonics = numHarmonicColumns / 3;
  const corner = info.boxes.corners.subarray(3 * block, 3 * block + 3),
    half = 2 ** (info.sizeLog - info.latticeBits - 1),
    size = 2 ** info.sizeLog;
  for (let i = 0, row = 0; i < count; i++, row += COLUMNS) {
    for (let a = 0; a < 3; a++) means[3 * i + a] = (2 * corner[a] + rows[row + POSITION + a]) * half;
    const s0 = rows[row + SCALE0],
      s1 = s0 - rows[row + ELONGATION],
      s2 = s1 - flatnessTable()[rows[row + FLATNESS]];
    scales[3 * i] = size * powerOfTwo(s0);
    scales[3 * i + 1] = size * powerOfTwo(s1);
    scales[3 * i + 2] = size * powerOfTwo(s2);
    opacities[i] = powerOfTwo(rows[row + OPACITY]);
    rgb(rows[row + LUMA] / UNIT, rows[row + LUMA + 1] / UNIT, rows[row + LUMA + 2] / UNIT, colours, 3 * i);
    quaternion(rows, row, quats, 4 * i);
    if (numHarmonicColumns)
      transformHarmonics(harmonics, i * numHarmonicColumns, transform, numHarmonics, splats.harmonics);
  }
  return splats;
}

/** Computes the harmonics of one Gaussian, `numHarmonics` per channel, by the transform. Most coded integers are 0. */
function transformHarmonics(
  coded: Int32Array,
  first: number,
  transform: Int8Array,
  numHarmonics: number,
  out: Float32Array,
): void {
  let empty = true;
  for (let k = 0, at = first; k < numHarmonics; k++, at += 3) {
    const y = coded[at],
      co = coded[at + 1],
      cg = coded[at + 2];
    if (!y && !co && !cg) continue;
    if (empty) SUM.fill(0);
    empty = false;
    for (let b = 0, n = 0, row = k * numHarmonics; b < numHarmonics; b++, n += 3) {
      const factor = transform[row + b];
      SUM[n] += y * factor;
      SUM[n + 1] += co * factor;
      SUM[n + 2] += cg * factor;
    }
  }
  if (empty) return;
  for (let n = 0; n < 3 * numHarmonics; n += 3)
    rgb(SUM[n] / SUMS, SUM[n + 1] / SUMS, SUM[n + 2] / SUMS, out, first + n);
}

/** Returns the coefficient of degree 0 of a colour. */
export const harmonicOf = (colour: number): number => (colour - 0.5) / DC;

/** Computes the quaternion of the frame given by the primary axis and the rotation about it (Shepperd, 1978). */
function quaternion(rows: Float64Array, row: number, out: Float32Array, at: number): void {
  const ax = rows[row + AXIS],
    ay = rows[row + AXIS + 1],
    az = rows[row + AXIS + 2],
    length = Math.sqrt(ax * ax + ay * ay + az * az) || 1,
    ux = ax / length,
    uy = ay / length,
    uz = az / length;
  // the coordinate axis of the least coordinate, projected
  const least =
      Math.abs(uy) < Math.abs(ux) ? (Math.abs(uz) < Math.abs(uy) ? 2 : 1) : Math.abs(uz) < Math.abs(ux) ? 2 : 0,
    dot = least === 0 ? ux : least === 1 ? uy : uz,
    tx = (least === 0 ? 1 : 0) - dot * ux,
    ty = (least === 1 ? 1 : 0) - dot * uy,
    tz = (least === 2 ? 1 : 0) - dot * uz;
  const angle = (rows[row + SPIN] * Math.PI) / WHOLES[rows[row + SPIN_BITS] + OCTAVES],
    norm = Math.sqrt(tx * tx + ty * ty + tz * tz),
    cos = Math.cos(angle) / norm,
    sin = Math.sin(angle) / norm;
  const vx = cos * tx + sin * (uy * tz - uz * ty),
    vy = cos * ty + sin * (uz * tx - ux * tz),
    vz = cos * tz + sin * (ux * ty - uy * tx);
  const wx = uy * vz - uz * vy,
    wy = uz * vx - ux * vz,
    wz = ux * vy - uy * vx;
  const primary = rows[row + PRIMARY];
  if (primary === 0) fromAxes(ux, uy, uz, vx, vy, vz, wx, wy, wz, out, at);
  else if (primary === 1) fromAxes(wx, wy, wz, ux, uy, uz, vx, vy, vz, out, at);
  else fromAxes(vx, vy, vz, wx, wy, wz, ux, uy, uz, out, at);
}

/**
 * Writes the quaternion of the rotation with the columns (xx, yx, zx), (xy, yy, zy) and (xz, yz, zz). Divides by its
 * largest component for accuracy.
 */
function fromAxes(
  xx: number,
  yx: number,
  zx: number,
  xy: number,
  yy: number,
  zy: number,
  xz: number,
  yz: number,
  zz: number,
  out: Float32Array,
  at: number,
): void {
  const trace = xx + yy + zz;
  let w = 1 + trace,
    x = zy - yz,
    y = xz - zx,
    z = yx - xy;
  if (trace < xx || trace < yy || trace < zz) {
    if (xx >= yy && xx >= zz) {
      w = x;
      x = 1 + 2 * xx - trace;
      y = yx + xy;
      z = zx + xz;
    } else if (yy >= zz) {
      w = y;
      x = yx + xy;
      y = 1 + 2 * yy - trace;
      z = zy + yz;
    } else {
      w = z;
      x = zx + xz;
      y = zy + yz;
      z = 1 + 2 * zz - trace;
    }
  }
  const size = Math.sqrt(w * w + x * x + y * y + z * z);
  out[at] = w / size;
  out[at + 1] = x / size;
  out[at + 2] = y / size;
  out[at + 3] = z / size;
}
