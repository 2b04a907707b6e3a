// What tracks do whose motion was lost: as the plane through the motions of their neighbours says. The twin of
// `splatwire.clips.concealment`.

import { KdTree } from "../../conceal/kd_tree.ts";
import { NUM_CHANNELS } from "./layout.ts";

const NEIGHBOURS = 16,
  /** Channels of scale, opacity and colour begin here. */
  FIRST_LOOK = 6,
  NEAREST = 0.1,
  RIDGE = 1e-3,
  /** A plane whose weights add up to more reaches too far out of its neighbours: their mean is safer. */
  WILD = 3;

/** How tracks of a group differ from their bases; n tracks, frames times channels each. */
export interface Poses {
  /** Slot of each track. */
  readonly slots: Int32Array;
  /** First frame in the group, and the first after. */
  readonly begins: Int32Array;
  readonly ends: Int32Array;
  readonly offsets: Float32Array;
}

/**
 * Adds to the offsets of `who` what neighbours among `told` (rows of `arrived`) changed since `since`, channels of each
 * slot; `means` are places of the bases.
 */
export function addMoves(
  arrived: Poses,
  told: Int32Array,
  who: Int32Array,
  since: Float32Array,
  means: Float32Array,
  frames: number,
  out: Float32Array,
): void {
  const points = new Float32Array(3 * told.length),
    size = frames * NUM_CHANNELS,
    count = Math.min(NEIGHBOURS, told.length);
  if (!count || !who.length) return;
  told.forEach((row, n) => place(means, since, arrived.slots[row], points, 3 * n));
  const tree = new KdTree(points, count),
    here = new Float32Array(3),
    moves = new Float64Array(size),
    low = new Float64Array(size),
    high = new Float64Array(size),
    offsets = new Float64Array(3 * count);
  who.forEach((slot, n) => {
    place(means, since, slot, here, 0);
    const near = tree.nearest(here[0], here[1], here[2]);
    near.forEach((m, i) => {
      for (let a = 0; a < 3; a++) offsets[3 * i + a] = points[3 * m + a] - here[a];
    });
    const weights = planeWeights(offsets, count);
    moves.fill(0);
    low.fill(Infinity);
    high.fill(-Infinity);
    for (let i = 0; i < count; i++) {
      const row = told[near[i]],
        from = row * size,
        before = arrived.slots[row] * NUM_CHANNELS;
      for (let k = 0; k < size; k++) {
        const change = arrived.offsets[from + k] - since[before + (k % NUM_CHANNELS)];
        moves[k] += weights[i] * change;
        low[k] = Math.min(low[k], change);
        high[k] = Math.max(high[k], change);
      }
    }
    // none grows, shines or reddens more than all around it
    for (let k = 0; k < size; k++)
      out[n * size + k] += k % NUM_CHANNELS < FIRST_LOOK ? moves[k] : Math.min(Math.max(moves[k], low[k]), high[k]);
  });
}

function place(means: Float32Array, since: Float32Array, slot: number, out: Float32Array, at: number): void {
  for (let a = 0; a < 3; a++) out[at + a] = means[3 * slot + a] + since[slot * NUM_CHANNELS + a];
}

/** Weights of neighbours at these offsets, 3 each: of the plane that fits best, near ones counting more. */
export function planeWeights(offsets: Float64Array, count: number): Float64Array {
  const near = new Float64Array(count);
  let mean = 1e-30,
    total = 0;
  for (let m = 0; m < 3 * count; m++) mean += offsets[m] ** 2 / count;
  const unit = Math.sqrt(mean),
    middle = [0, 0, 0];
  for (let m = 0; m < count; m++) {
    const square = offsets[3 * m] ** 2 + offsets[3 * m + 1] ** 2 + offsets[3 * m + 2] ** 2;
    total += near[m] = 1 / (square / mean + NEAREST);
  }
  for (let m = 0; m < count; m++) {
    near[m] /= total;
    for (let a = 0; a < 3; a++) middle[a] += (near[m] * offsets[3 * m + a]) / unit;
  }
  const s = new Float64Array(9);
  for (let m = 0; m < count; m++) {
    for (let a = 0; a < 3; a++) {
      const p = offsets[3 * m + a] / unit - middle[a];
      for (let b = 0; b < 3; b++) s[3 * a + b] += near[m] * p * (offsets[3 * m + b] / unit - middle[b]);
    }
  }
  const ridge = RIDGE * (s[0] + s[4] + s[8]) + 1e-12;
  for (let a = 0; a < 3; a++) s[4 * a] += ridge;
  const slope = solve(s, middle);
  const weights = near.map((w, m) => {
    let dot = 0;
    for (let a = 0; a < 3; a++) dot += (offsets[3 * m + a] / unit - middle[a]) * slope[a];
    return w * (1 - dot);
  });
  return weights.reduce((sum, weight) => sum + Math.abs(weight), 0) > WILD ? near : weights;
}

/** Of a symmetric positive 3 x 3 matrix, by its adjugate. */
function solve(s: Float64Array, v: readonly number[]): number[] {
  const a = s[4] * s[8] - s[5] * s[5],
    b = s[2] * s[5] - s[1] * s[8],
    c = s[1] * s[5] - s[2] * s[4],
    d = s[0] * s[8] - s[2] * s[2],
    e = s[1] * s[2] - s[0] * s[5],
    f = s[0] * s[4] - s[1] * s[1],
    determinant = s[0] * a + s[1] * b + s[2] * c;
  return [a * v[0] + b * v[1] + c * v[2], b * v[0] + d * v[1] + e * v[2], c * v[0] + e * v[1] + f * v[2]].map(
    (value) => value / determinant,
  );
}
