// Decoded integers as Gaussians: the only floats of the codec, at its very end.

import { DC, emptySplats, type Splats } from "../splats.ts";
import {
  AXIS,
  BITS,
  COLUMNS,
  LATTICE,
  LUMA,
  OPACITY,
  PRIMARY,
  SCALE0,
  SCALE1,
  SCALE2,
  SPIN,
  SPIN_BITS,
  TRANSFORM_UNIT,
} from "./layout.ts";
import type { Decoded } from "./packet.ts";
import type { SideInfo } from "./side_info.ts";
import { THINNESS } from "./tables.ts";

const R2 = Math.sqrt(2),
  R3 = Math.sqrt(3),
  R6 = Math.sqrt(6),
  UNIT = 2 ** BITS,
  SUMS = UNIT * TRANSFORM_UNIT;
/** Of the harmonics of one Gaussian, at most 15 to a channel. */
const SUM = new Float64Array(45);

/** Orthonormal Y Co Cg as red, green, blue. */
function rgb(y: number, co: number, cg: number, out: Float32Array, at: number): void {
  out[at] = y / R3 + co / R2 - cg / R6;
  out[at + 1] = y / R3 + (2 * cg) / R6;
  out[at + 2] = y / R3 - co / R2 - cg / R6;
}

export function toSplats({ rows, harmonics }: Decoded, info: SideInfo, block: number): Splats {
  const count = rows.length / COLUMNS,
    splats = emptySplats(count, info.degree);
  const corner = info.boxes.corners.subarray(3 * block, 3 * block + 3),
    number = info.numHarmonics / 3;
  const half = 2 ** (info.sizeLog - info.unit - 1),
    size = 2 ** info.sizeLog;
  for (let i = 0; i < count; i++) {
    const row = i * COLUMNS;
    for (let a = 0; a < 3; a++) splats.means[3 * i + a] = (2 * corner[a] + rows[row + LATTICE + a]) * half;
    const s0 = rows[row + SCALE0],
      s1 = s0 - rows[row + SCALE1],
      s2 = s1 - THINNESS[rows[row + SCALE2]];
    splats.scales[3 * i] = size * 2 ** (s0 / UNIT);
    splats.scales[3 * i + 1] = size * 2 ** (s1 / UNIT);
    splats.scales[3 * i + 2] = size * 2 ** (s2 / UNIT);
    splats.opacities[i] = 2 ** (rows[row + OPACITY] / UNIT);
    rgb(rows[row + LUMA] / UNIT, rows[row + LUMA + 1] / UNIT, rows[row + LUMA + 2] / UNIT, splats.colours, 3 * i);
    quaternion(rows, row, splats.quats, 4 * i);
    transformed(harmonics, i * info.numHarmonics, info.transform, number, splats.harmonics);
  }
  return splats;
}

/** Harmonics of one Gaussian, `number` to a channel: what their numbers, of which most are 0, add to them. */
function transformed(
  numbers: Int32Array,
  first: number,
  transform: Int8Array,
  number: number,
  out: Float32Array,
): void {
  let empty = true;
  for (let k = 0, at = first; k < number; k++, at += 3) {
    const y = numbers[at],
      co = numbers[at + 1],
      cg = numbers[at + 2];
    if (!y && !co && !cg) continue;
    if (empty) SUM.fill(0);
    empty = false;
    for (let b = 0, n = 0, row = k * number; b < number; b++, n += 3) {
      const share = transform[row + b];
      SUM[n] += y * share;
      SUM[n + 1] += co * share;
      SUM[n + 2] += cg * share;
    }
  }
  if (empty) return;
  for (let n = 0; n < 3 * number; n += 3) rgb(SUM[n] / SUMS, SUM[n + 1] / SUMS, SUM[n + 2] / SUMS, out, first + n);
}

/** Harmonic of degree 0 of a colour. */
export const harmonicOf = (colour: number): number => (colour - 0.5) / DC;

/** Axes from the primary one and the turn about it, as a quaternion (Shepperd, 1978). */
function quaternion(rows: Float64Array, row: number, out: Float32Array, at: number): void {
  const ax = rows[row + AXIS],
    ay = rows[row + AXIS + 1],
    az = rows[row + AXIS + 2],
    length = Math.sqrt(ax * ax + ay * ay + az * az) || 1;
  U[0] = ax / length;
  U[1] = ay / length;
  U[2] = az / length;
  let least = 0;
  for (let a = 1; a < 3; a++) if (Math.abs(U[a]) < Math.abs(U[least])) least = a;
  const dot = U[least];
  for (let a = 0; a < 3; a++) T[a] = (a === least ? 1 : 0) - dot * U[a];
  cross(U, T, W);
  const angle = (rows[row + SPIN] * Math.PI) / 2 ** rows[row + SPIN_BITS],
    norm = Math.sqrt(T[0] * T[0] + T[1] * T[1] + T[2] * T[2]);
  const cos = Math.cos(angle) / norm,
    sin = Math.sin(angle) / norm;
  for (let a = 0; a < 3; a++) V[a] = cos * T[a] + sin * W[a];
  cross(U, V, W);
  const primary = rows[row + PRIMARY],
    x = primary === 0 ? U : primary === 1 ? W : V,
    y = primary === 0 ? V : primary === 1 ? U : W;
  const z = primary === 0 ? W : primary === 1 ? V : U;
  fromAxes(x, y, z, out, at);
}

const U = new Float64Array(3),
  T = new Float64Array(3),
  V = new Float64Array(3),
  W = new Float64Array(3);

function cross(a: Float64Array, b: Float64Array, out: Float64Array): void {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

/** A rotation whose columns are x, y and z, from the largest of the four. */
function fromAxes(x: Float64Array, y: Float64Array, z: Float64Array, out: Float32Array, at: number): void {
  const trace = x[0] + y[1] + z[2];
  let qw = 1 + trace,
    qx = y[2] - z[1],
    qy = z[0] - x[2],
    qz = x[1] - y[0];
  if (trace < x[0] || trace < y[1] || trace < z[2]) {
    const xy = x[1] + y[0],
      xz = z[0] + x[2],
      yz = y[2] + z[1];
    if (x[0] >= y[1] && x[0] >= z[2]) [qw, qx, qy, qz] = [qx, 1 + 2 * x[0] - trace, xy, xz];
    else if (y[1] >= z[2]) [qw, qx, qy, qz] = [qy, xy, 1 + 2 * y[1] - trace, yz];
    else [qw, qx, qy, qz] = [qz, xz, yz, 1 + 2 * z[2] - trace];
  }
  const size = Math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz);
  out[at] = qw / size;
  out[at + 1] = qx / size;
  out[at + 2] = qy / size;
  out[at + 3] = qz / size;
}
