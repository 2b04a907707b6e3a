// Motion at any position, interpolated from the nearest tracks with received motion.

import { KdTree } from "../../conceal/kd_tree.ts";
import { DC } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";
import { COLOUR, changedKinds, FIRST_SHAPE, type NeighbourSet, NeighbourSums, POSE, SHAPE } from "./neighbours.ts";
import { proximityWeights, Quadratic } from "./quadratic.ts";
import type { TrackOffsets, TrackProperties } from "./track_offsets.ts";

export const NEIGHBOURS = 40;
/** Squared colour contrast at which the correction by contrast is halved. */
const COLOUR_RIDGE = 0.1 * DC * DC;
/** Kinds of changing channels of a row that was no neighbour yet. */
const UNKNOWN = 255;

/** Motion field of a set of tracks. */
export class MotionField {
  readonly #tree: KdTree;
  readonly #fit: Quadratic;
  readonly #currentSums: NeighbourSums;
  readonly #previousSums: NeighbourSums;
  /** Kinds of channels that change in each row, or `UNKNOWN`; and kinds with a non-zero offset before the group. */
  readonly #changedKinds: Uint8Array;
  readonly #previousKinds: Uint8Array;
  /**
   * Neighbours of the last query by row, the same by arrival index for the state before the group, and their positions
   * relative to the query.
   */
  readonly #neighbours: NeighbourSet;
  readonly #previousNeighbours: NeighbourSet;
  readonly #relativePositions: Float64Array;
  readonly #contrast = new Float64Array(3);
  readonly #position = new Float32Array(3);
  readonly #deviation = new Float32Array(NUM_CHANNELS);
  readonly #found: Float32Array;

  /**
   * `referenceOffsets`, shape (rows, channels), are subtracted from the offsets of the rows `observedRows` and added
   * to their positions; null means 0.
   */
  constructor(
    readonly received: TrackOffsets,
    readonly observedRows: Int32Array,
    readonly referenceOffsets: Float32Array | null,
    readonly trackProperties: TrackProperties,
    readonly frames: number,
  ) {
    const points = new Float32Array(3 * observedRows.length),
      { means } = trackProperties.splats,
      count = Math.min(NEIGHBOURS, observedRows.length);
    for (let n = 0; n < observedRows.length; n++)
      for (let a = 0; a < 3; a++)
        points[3 * n + a] =
          means[3 * received.arrivalIndices[observedRows[n]] + a] +
          (referenceOffsets ? referenceOffsets[n * NUM_CHANNELS + a] : 0);
    this.#tree = new KdTree(points, count);
    this.#fit = new Quadratic(count);
    this.#currentSums = new NeighbourSums(frames, count, received.offsets, referenceOffsets);
    this.#previousSums = new NeighbourSums(1, count, trackProperties.lastOffsets, null);
    this.#changedKinds = new Uint8Array(observedRows.length).fill(UNKNOWN);
    this.#previousKinds = new Uint8Array(observedRows.length);
    this.#neighbours = emptyNeighbours(count);
    this.#previousNeighbours = { ...this.#neighbours, rows: new Int32Array(count), kinds: new Uint8Array(count) };
    this.#relativePositions = new Float64Array(3 * count);
    this.#found = new Float32Array(frames * NUM_CHANNELS);
  }

  /** Leaves rows out of the neighbours (1), by row of the received motion. At least `NEIGHBOURS` must remain. */
  leaveOut(rows: Uint8Array): void {
    this.#tree.leftOut = Uint8Array.from(this.observedRows, (row) => rows[row]);
  }

  /** Determines the kinds of an observed row when it is a neighbour for the first time. */
  #findKinds(n: number): void {
    if (this.#changedKinds[n] !== UNKNOWN) return;
    const { received, referenceOffsets, trackProperties, frames } = this,
      row = this.observedRows[n],
      size = frames * NUM_CHANNELS,
      last = received.arrivalIndices[row] * NUM_CHANNELS,
      kindsOfReference = referenceOffsets
        ? changedKinds(referenceOffsets, n * NUM_CHANNELS, (n + 1) * NUM_CHANNELS)
        : 0;
    this.#changedKinds[n] = changedKinds(received.offsets, row * size, (row + 1) * size) | kindsOfReference;
    this.#previousKinds[n] = changedKinds(trackProperties.lastOffsets, last, last + NUM_CHANNELS);
  }

  /**
   * Predicts a track's offsets: the neighbours' motion plus the track's earlier deviation from it. The deviation counts
   * less if it is small compared with its quantisation step.
   */
  predict(arrivalIndex: number, out: Float32Array): void {
    const { lastOffsets, wasConcealed, positionStep } = this.trackProperties,
      deviation = this.#deviation,
      changed = this.#queryNeighbours(arrivalIndex, 0),
      previous = unionOf(this.#previousNeighbours.kinds) & POSE;
    this.#computeWeights(arrivalIndex, changed | previous);
    this.#currentSums.of(this.#neighbours, changed, this.#contrast, out);
    if (wasConcealed?.[arrivalIndex]) return;
    this.#previousSums.of(this.#previousNeighbours, previous, this.#contrast, deviation);
    let square = 0;
    for (let c = 0; c < FIRST_SHAPE; c++) deviation[c] = lastOffsets[arrivalIndex * NUM_CHANNELS + c] - deviation[c];
    for (let a = 0; a < 3; a++) square += deviation[a] * deviation[a];
    if (!square) return;
    const trust = square / (square + positionStep(arrivalIndex) ** 2 + 1e-30);
    for (let frame = 0; frame < this.frames; frame++)
      for (let c = 0; c < FIRST_SHAPE; c++) out[frame * NUM_CHANNELS + c] += trust * deviation[c];
  }

  /** Adds the neighbours' changes to a track's offsets. */
  addChanges(arrivalIndex: number, out: Float32Array): void {
    const found = this.#found,
      changed = this.#queryNeighbours(arrivalIndex, 1);
    this.#computeWeights(arrivalIndex, changed);
    this.#currentSums.of(this.#neighbours, changed, this.#contrast, found);
    for (let k = 0; k < out.length; k++) out[k] += found[k];
  }

  /**
   * Finds the neighbours of a track. `moved` is 1 if its last offset applies, otherwise 0. Returns the kinds of
   * channels that change.
   */
  #queryNeighbours(arrivalIndex: number, moved: number): number {
    const { observedRows, received } = this,
      { points } = this.#tree,
      { splats, lastOffsets } = this.trackProperties,
      { means } = splats,
      position = this.#position,
      relative = this.#relativePositions,
      { rows, referenceRows, kinds } = this.#neighbours,
      previous = this.#previousNeighbours;
    for (let a = 0; a < 3; a++)
      position[a] = means[3 * arrivalIndex + a] + moved * lastOffsets[arrivalIndex * NUM_CHANNELS + a];
    const near = this.#tree.nearest(position[0], position[1], position[2]);
    for (let i = 0; i < near.length; i++) {
      const n = near[i],
        row = observedRows[n];
      for (let a = 0; a < 3; a++) relative[3 * i + a] = points[3 * n + a] - position[a];
      this.#findKinds(n);
      rows[i] = row;
      referenceRows[i] = n;
      kinds[i] = this.#changedKinds[n];
      previous.rows[i] = received.arrivalIndices[row];
      previous.kinds[i] = this.#previousKinds[n];
    }
    return unionOf(kinds);
  }

  /** Computes the neighbours' weights for the kinds of channels that change. */
  #computeWeights(arrivalIndex: number, changed: number): void {
    const { closeness, weights } = this.#neighbours;
    if (!changed) return;
    const unit = proximityWeights(this.#relativePositions, closeness);
    if (changed & (POSE | SHAPE)) this.#fit.weights(this.#relativePositions, closeness, unit, weights);
    if (changed & COLOUR) this.#computeContrasts(arrivalIndex);
  }

  /** Computes the colour contrasts of the neighbours and of the track to the neighbours' mean. */
  #computeContrasts(arrivalIndex: number): void {
    const { colours } = this.trackProperties.splats,
      { closeness, contrasts } = this.#neighbours,
      arrivalIndices = this.#previousNeighbours.rows,
      mean = this.#contrast.fill(0);
    for (let i = 0; i < arrivalIndices.length; i++)
      for (let a = 0; a < 3; a++) mean[a] += closeness[i] * colours[3 * arrivalIndices[i] + a];
    let square = COLOUR_RIDGE;
    for (let i = 0; i < arrivalIndices.length; i++) {
      for (let a = 0; a < 3; a++) {
        const contrast = colours[3 * arrivalIndices[i] + a] - mean[a];
        square += closeness[i] * contrast * contrast;
        contrasts[3 * i + a] = closeness[i] * contrast;
      }
    }
    for (let k = 0; k < contrasts.length; k++) contrasts[k] /= square;
    for (let a = 0; a < 3; a++) this.#contrast[a] = colours[3 * arrivalIndex + a] - mean[a];
  }
}

function emptyNeighbours(count: number): NeighbourSet {
  return {
    rows: new Int32Array(count),
    referenceRows: new Int32Array(count),
    kinds: new Uint8Array(count),
    weights: new Float64Array(count),
    closeness: new Float64Array(count),
    contrasts: new Float64Array(3 * count),
  };
}

function unionOf(kinds: Uint8Array): number {
  let found = 0;
  for (let i = 0; i < kinds.length; i++) found |= kinds[i];
  return found;
}
