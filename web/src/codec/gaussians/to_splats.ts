// Decoded integers as Gaussians: the only floats of the codec, at its very end.

import { DC, emptySplats, type Splats } from "../splats.ts";
import { AXIS, BITS, COLUMNS, LATTICE, LUMA, OPACITY, PRIMARY, SCALE0, SCALE1, SCALE2, SPIN, SPIN_BITS, TRANSFORM_UNIT } from "./layout.ts";
import type { Decoded } from "./packet.ts";
import type { SideInfo } from "./side_info.ts";
import { THINNESS } from "./tables.ts";

const R2 = Math.sqrt(2), R3 = Math.sqrt(3), R6 = Math.sqrt(6), UNIT = 2 ** BITS, SUMS = UNIT * TRANSFORM_UNIT;

/** Orthonormal Y Co Cg as red, green, blue. */
function rgb(y: number, co: number, cg: number, out: Float32Array, at: number): void {
  out[at] = y / R3 + co / R2 - cg / R6;
  out[at + 1] = y / R3 + (2 * cg) / R6;
  out[at + 2] = y / R3 - co / R2 - cg / R6;
}

export function toSplats({ rows, harmonics }: Decoded, info: SideInfo, block: number): Splats {
  const count = rows.length / COLUMNS, splats = emptySplats(count, info.degree);
  const corner = info.boxes.corners.subarray(3 * block, 3 * block + 3), number = info.numHarmonics / 3;
  const half = 2 ** (info.sizeLog - info.unit - 1), size = 2 ** info.sizeLog, sum = [0, 0, 0];
  for (let i = 0; i < count; i++) {
    const row = rows.subarray(i * COLUMNS, (i + 1) * COLUMNS);
    for (let a = 0; a < 3; a++) splats.means[3 * i + a] = (2 * corner[a] + row[LATTICE + a]) * half;
    const s0 = row[SCALE0], s1 = s0 - row[SCALE1], s2 = s1 - THINNESS[row[SCALE2]];
    splats.scales.set([size * 2 ** (s0 / UNIT), size * 2 ** (s1 / UNIT), size * 2 ** (s2 / UNIT)], 3 * i);
    splats.opacities[i] = 2 ** (row[OPACITY] / UNIT);
    rgb(row[LUMA] / UNIT, row[LUMA + 1] / UNIT, row[LUMA + 2] / UNIT, splats.colours, 3 * i);
    quaternion(row, splats.quats, 4 * i);
    for (let b = 0; b < number; b++) {
      sum.fill(0);
      for (let k = 0, at = i * info.numHarmonics; k < number; k++) {
        for (let c = 0; c < 3; c++, at++) sum[c] += harmonics[at] * info.transform[k * number + b];
      }
      rgb(sum[0] / SUMS, sum[1] / SUMS, sum[2] / SUMS, splats.harmonics, 3 * (i * number + b));
    }
  }
  return splats;
}

/** Harmonic of degree 0 of a colour. */
export const harmonicOf = (colour: number): number => (colour - 0.5) / DC;

const cross = (a: readonly number[], b: readonly number[]): [number, number, number] => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];

/** Axes from the primary one and the turn about it, as a quaternion (Shepperd, 1978). */
function quaternion(row: Float64Array, out: Float32Array, at: number): void {
  const length = Math.hypot(row[AXIS], row[AXIS + 1], row[AXIS + 2]) || 1;
  const u = [row[AXIS] / length, row[AXIS + 1] / length, row[AXIS + 2] / length];
  let least = 0;
  for (let a = 1; a < 3; a++) if (Math.abs(u[a]) < Math.abs(u[least])) least = a;
  const t = u.map((value, a) => (a === least ? 1 : 0) - u[least] * value), norm = Math.hypot(t[0], t[1], t[2]);
  const b = cross(u, t), angle = (row[SPIN] * Math.PI) / 2 ** row[SPIN_BITS];
  const v = t.map((value, a) => (Math.cos(angle) * value + Math.sin(angle) * b[a]) / norm), w = cross(u, v);
  const columns: (readonly number[])[] = [u, u, u], primary = row[PRIMARY];
  columns[(primary + 1) % 3] = v;
  columns[(primary + 2) % 3] = w;
  const [[xx, yx, zx], [xy, yy, zy], [xz, yz, zz]] = columns;
  const squares = [1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz];
  const most = squares.indexOf(Math.max(...squares));
  const x = zy - yz, y = xz - zx, z = yx - xy;
  const found = [
    [squares[0], x, y, z], [x, squares[1], xy + yx, xz + zx], [y, xy + yx, squares[2], yz + zy], [z, xz + zx, yz + zy, squares[3]],
  ][most];
  const size = Math.hypot(...found);
  for (let a = 0; a < 4; a++) out[at + a] = found[a] / size;
}
