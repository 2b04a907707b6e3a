// Selects how lost tracks are covered in each region, by cross-validation on received tracks. Counterpart of
// `splatwire.concealment.temporal.selection`.

import { KdTree } from "../../conceal/kd_tree.ts";
import type { Splats } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";
import type { TrackOffsets, TrackProperties } from "./track_offsets.ts";

/** Coordinates x, y, z. */
type Point = Float32Array;

/** Methods to cover a lost track: interpolated motion, the last position, and enlarged received Gaussians. */
export const INTERPOLATED = 0,
  HELD = 1,
  HIDDEN = 2;
const NUM_METHODS = 3,
  /** Largest number of received tracks that are treated as lost. */
  MAX_TESTS = 1024,
  /** At most one received track in `TESTED_DIVISOR` is treated as lost at the same time. */
  TESTED_DIVISOR = 4,
  /** Number of tested tracks around a lost track; their errors are added. */
  MIN_TESTS = 16,
  /** Number of received Gaussians that are considered at a position. */
  COVERING = 24,
  /** Factors on the errors of the methods. */
  FACTORS = [0.9, 1, 0.6],
  /** Weights of errors of red, green, blue and opacity. */
  CHANNEL_WEIGHTS = [1, 1, 1, 0.5];

/**
 * Estimates the motion of the tracks with the arrival indices `lostTracks`, in this order, shape (lostTracks, frames,
 * channels). Rows with 1 in `leftOut` are not used.
 */
type Interpolate = (leftOut: Uint8Array, lostTracks: Int32Array) => Float32Array;
/** Returns the first frame and the end frame of a track, as expected without its motion. */
type Lifetime = (arrivalIndex: number) => readonly [number, number];

/**
 * Chooses for each track the method with the lowest error on the nearby received tracks. `lostTracks` are
 * arrival indices. `order` lists the rows of `received` by ascending track.
 */
export function select(
  received: TrackOffsets,
  order: Int32Array,
  lostTracks: Int32Array,
  frames: number,
  trackProperties: TrackProperties,
  interpolate: Interpolate,
  lifetime: Lifetime,
): Uint8Array {
  const found = new Uint8Array(lostTracks.length),
    stride = Math.max(Math.ceil(order.length / MAX_TESTS), 1),
    tested = order.filter((_, n) => n % stride === 0);
  const folds = Math.ceil(TESTED_DIVISOR / stride),
    errors = testErrors(received, order, tested, folds, frames, trackProperties, interpolate, lifetime),
    { isNew, lastOffsets, splats } = trackProperties,
    lastPlace = (arrivalIndex: number) => moved(splats, arrivalIndex, lastOffsets, arrivalIndex);
  // the first frame of a new track is known, so that its motion is estimated better
  for (const isNewTrack of [true, false]) {
    const peers = [...tested.keys()].filter((n) => isNew(received.arrivalIndices[tested[n]]) === isNewTrack);
    if (peers.length < MIN_TESTS) continue;
    const arrivalIndices = Int32Array.from(peers, (n) => received.arrivalIndices[tested[n]]),
      tree = new KdTree(
        positionsOf(splats, arrivalIndices, lastOffsets, (n) => arrivalIndices[n]),
        MIN_TESTS,
      );
    lostTracks.forEach((arrivalIndex, n) => {
      if (isNew(arrivalIndex) !== isNewTrack) return;
      const sums = [0, 0, 0];
      for (const near of nearest(tree, lastPlace(arrivalIndex)))
        for (let method = 0; method < NUM_METHODS; method++) sums[method] += errors[NUM_METHODS * peers[near] + method];
      found[n] = sums.indexOf(Math.min(...sums));
    });
  }
  return found;
}

/**
 * Returns the error of each method to cover each tested row, shape (tested, NUM_METHODS). Every `folds`-th tested row
 * is treated as lost at the same time.
 */
function testErrors(
  received: TrackOffsets,
  order: Int32Array,
  tested: Int32Array,
  folds: number,
  frames: number,
  trackProperties: TrackProperties,
  interpolate: Interpolate,
  lifetime: Lifetime,
): Float64Array {
  const { arrivalIndices, begins, ends, offsets } = received,
    { splats, lastOffsets } = trackProperties,
    errors = new Float64Array(NUM_METHODS * tested.length),
    foldOf = new Int8Array(arrivalIndices.length).fill(-1);
  tested.forEach((row, n) => (foldOf[row] = n % folds));
  const estimates = Array.from({ length: folds }, (_, fold) =>
    interpolate(
      Uint8Array.from(foldOf, (other) => Number(other === fold)),
      tested.filter((row) => foldOf[row] === fold).map((row) => arrivalIndices[row]),
    ),
  );
  let tree: KdTree | null = null;
  for (const frame of new Set([1, 3, 5].map((part) => Math.floor((part * frames) / 6)))) {
    const exists = (row: number) => begins[row] <= frame && frame < ends[row],
      place = (row: number) => moved(splats, arrivalIndices[row], offsets, row * frames + frame),
      absent = Uint8Array.from(order, (row) => Number(!exists(row))),
      count = absent.length - absent.reduce((sum, gone) => sum + gone, 0);
    if (!count) continue;
    const positions = positionsOf(
      splats,
      order.map((row) => arrivalIndices[row]),
      offsets,
      (n) => order[n] * frames + frame,
    );
    tree = new KdTree(positions, Math.min(COVERING, count), null, tree);
    tree.leftOut = absent;
    const around = (point: Point, fold: number): Float64Array => {
      const sums = new Float64Array(4),
        near = nearest(tree!, point);
      for (let i = 0; i < near.length; i++) {
        const other = order[near[i]];
        if (foldOf[other] !== fold) addDensity(splats, arrivalIndices[other], tree!.distances[i], sums);
      }
      return sums;
    };
    tested.forEach((row, n) => {
      const arrivalIndex = arrivalIndices[row],
        fold = n % folds,
        truth = exists(row) ? place(row) : null,
        [begin, end] = lifetime(arrivalIndex),
        motion = Math.floor(n / folds) * frames + frame,
        methods = [
          moved(splats, arrivalIndex, estimates[fold], motion),
          moved(splats, arrivalIndex, lastOffsets, arrivalIndex),
        ],
        aroundTruth = truth && around(truth, fold);
      for (let method = 0; method < NUM_METHODS; method++) {
        const estimate = begin <= frame && frame < end && method !== HIDDEN ? methods[method] : null;
        let error = 0;
        if (truth) error += difference(splats, aroundTruth!, truth, arrivalIndex, truth, estimate);
        if (estimate) error += difference(splats, around(estimate, fold), estimate, arrivalIndex, truth, estimate);
        errors[NUM_METHODS * n + method] += error * FACTORS[method];
      }
    });
  }
  return errors;
}

/** Position of a keyframe Gaussian with the offset in a row of `offsets`. */
function moved(splats: Splats, arrivalIndex: number, offsets: Float32Array, row: number): Point {
  return positionsOf(splats, [arrivalIndex], offsets, () => row);
}

/** Positions of keyframe Gaussians, shape (keyframes, 3), each with the offset in a row of `offsets`. */
export function positionsOf(
  { means }: Splats,
  arrivalIndices: ArrayLike<number>,
  offsets: Float32Array,
  rowOf: (n: number) => number,
): Float32Array {
  const found = new Float32Array(3 * arrivalIndices.length);
  for (let n = 0; n < arrivalIndices.length; n++) {
    const at = rowOf(n) * NUM_CHANNELS;
    for (let a = 0; a < 3; a++) found[3 * n + a] = means[3 * arrivalIndices[n] + a] + offsets[at + a];
  }
  return found;
}

const nearest = (tree: KdTree, [x, y, z]: Point): Int32Array => tree.nearest(x, y, z);

/** Mean squared axis length of a Gaussian. */
function squareOf({ scales }: Splats, arrivalIndex: number): number {
  return (
    (scales[3 * arrivalIndex] ** 2 + scales[3 * arrivalIndex + 1] ** 2 + scales[3 * arrivalIndex + 2] ** 2) / 3 + 1e-30
  );
}

/** Adds the colour and the number 1, weighted by the density of a Gaussian at a squared distance from its centre. */
function addDensity(splats: Splats, arrivalIndex: number, squaredDistance: number, sums: Float64Array): void {
  const density = splats.opacities[arrivalIndex] * Math.exp(-squaredDistance / (2 * squareOf(splats, arrivalIndex)));
  for (let a = 0; a < 3; a++) sums[a] += density * splats.colours[3 * arrivalIndex + a];
  sums[3] += density;
}

/**
 * Returns the squared difference at a point between two positions of a track, times its area. The track is missing at
 * position null. `around` are the sums of the other Gaussians there.
 */
function difference(
  splats: Splats,
  around: Float64Array,
  point: Point,
  arrivalIndex: number,
  truth: Point | null,
  estimate: Point | null,
): number {
  const [first, second] = [truth, estimate].map((place) => {
    const sums = around.slice();
    if (place) addDensity(splats, arrivalIndex, squaredDistance(place, point), sums);
    const share = (1 - Math.exp(-sums[3])) / Math.max(sums[3], 1e-12);
    return sums.map((sum, a) => share * sum * CHANNEL_WEIGHTS[a]);
  });
  let apart = 0;
  for (let a = 0; a < 4; a++) apart += (first[a] - second[a]) ** 2;
  return squareOf(splats, arrivalIndex) * splats.opacities[arrivalIndex] * apart;
}

function squaredDistance(first: Point, second: Point): number {
  return first.reduce((sum, value, a) => sum + (value - second[a]) ** 2, 0);
}
