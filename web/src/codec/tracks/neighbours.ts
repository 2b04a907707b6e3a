// Weighted sums of neighbours' motion. Adds four neighbours at a time and skips channels that do not change.

import { NUM_CHANNELS } from "./layout.ts";

/** First channel of scale and opacity, and first channel of colour. Position and rotation have smaller indices. */
export const FIRST_SHAPE = 6,
  FIRST_COLOUR = 10;

/** Kinds of changing channels, as bits. */
export const POSE = 1,
  SHAPE = 2,
  COLOUR = 4;
const ALL = POSE | SHAPE | COLOUR,
  /** Neighbours added per pass, so that each sum is read and written once for all of them. */
  NEIGHBOURS_PER_PASS = 4;

/** Returns the kinds of channels with a value other than 0 in the frames of a row from index `begin` to `end`. */
export function changedKinds(values: Float32Array, begin: number, end: number): number {
  let found = 0;
  for (let at = begin; at < end && found < ALL; at += NUM_CHANNELS) {
    if (!(found & POSE) && changes(values, at, at + FIRST_SHAPE)) found |= POSE;
    if (!(found & SHAPE) && changes(values, at + FIRST_SHAPE, at + FIRST_COLOUR)) found |= SHAPE;
    if (!(found & COLOUR) && changes(values, at + FIRST_COLOUR, at + NUM_CHANNELS)) found |= COLOUR;
  }
  return found;
}

function changes(values: Float32Array, begin: number, end: number): boolean {
  for (let at = begin; at < end; at++) if (values[at]) return true;
  return false;
}

/** Neighbours of one track. */
export interface NeighbourSet {
  /** Row of each neighbour in the values. */
  readonly rows: Int32Array;
  /** Row of each neighbour in the reference offsets. */
  readonly referenceRows: Int32Array;
  /** Kinds of channels that change in each neighbour. */
  readonly kinds: Uint8Array;
  /**
   * Weights for position, rotation and shape (`weights`), for colour (`closeness`), and by colour contrast
   * (`contrasts`).
   */
  readonly weights: Float64Array;
  readonly closeness: Float64Array;
  readonly contrasts: Float64Array;
}

/** Sums over neighbours for a number of frames. */
export class NeighbourSums {
  readonly #sums: Float64Array;
  readonly #lows: Float64Array;
  readonly #highs: Float64Array;
  readonly #shares: Float64Array;
  /** Offset of each changing neighbour's values, and its weight. Padded with weights of 0. */
  readonly #valueOffsets: Int32Array;
  readonly #weights: Float64Array;

  /**
   * `values` has shape (rows, frames, channels). `referenceOffsets`, shape (rows, channels), are subtracted; null
   * means 0.
   */
  constructor(
    readonly frames: number,
    maxNeighbours: number,
    readonly values: Float32Array,
    readonly referenceOffsets: Float32Array | null,
  ) {
    this.#sums = new Float64Array(frames * NUM_CHANNELS);
    this.#lows = new Float64Array(frames * NUM_CHANNELS);
    this.#highs = new Float64Array(frames * NUM_CHANNELS);
    this.#shares = new Float64Array(frames);
    this.#valueOffsets = new Int32Array(maxNeighbours + NEIGHBOURS_PER_PASS);
    this.#weights = new Float64Array(maxNeighbours + NEIGHBOURS_PER_PASS);
  }

  /**
   * Writes the predicted offsets of a track. `kinds` are the neighbours' changing kinds, `contrast` is the track's
   * colour contrast.
   */
  of(near: NeighbourSet, kinds: number, contrast: Float64Array, out: Float32Array): void {
    const sums = this.#sums.fill(0);
    if (kinds & POSE) this.#add(near, POSE, near.weights, 0, FIRST_SHAPE);
    if (kinds & SHAPE) {
      this.#add(near, SHAPE, near.weights, FIRST_SHAPE, FIRST_COLOUR);
      this.#clampToNeighbours(near);
    }
    if (kinds & COLOUR) {
      this.#add(near, COLOUR, near.closeness, FIRST_COLOUR, NUM_CHANNELS);
      this.#addContrast(near, contrast);
    }
    out.set(sums);
  }

  #add(near: NeighbourSet, kind: number, weights: Float64Array, begin: number, end: number): void {
    const { values } = this,
      sums = this.#sums,
      numChanging = this.#selectChanging(near, kind, weights),
      width = end - begin;
    for (let i = 0; i < numChanging; i += NEIGHBOURS_PER_PASS) {
      const p = this.#weights[i],
        q = this.#weights[i + 1],
        r = this.#weights[i + 2],
        s = this.#weights[i + 3];
      let a = this.#valueOffsets[i] + begin,
        b = this.#valueOffsets[i + 1] + begin,
        c = this.#valueOffsets[i + 2] + begin,
        d = this.#valueOffsets[i + 3] + begin;
      for (let k = begin; k < sums.length; k += NUM_CHANNELS) {
        for (let n = 0; n < width; n++)
          sums[k + n] += p * values[a + n] + q * values[b + n] + (r * values[c + n] + s * values[d + n]);
        a += NUM_CHANNELS;
        b += NUM_CHANNELS;
        c += NUM_CHANNELS;
        d += NUM_CHANNELS;
      }
    }
    if (this.referenceOffsets) this.#subtract(near, this.referenceOffsets, weights, begin, end);
  }

  /** Lists the neighbours that change in a kind of channel. Returns their number, rounded up. */
  #selectChanging({ rows, kinds }: NeighbourSet, kind: number, weights: Float64Array): number {
    const stride = this.frames * NUM_CHANNELS;
    let numChanging = 0;
    for (let i = 0; i < rows.length; i++) {
      if (!(kinds[i] & kind)) continue;
      this.#valueOffsets[numChanging] = rows[i] * stride;
      this.#weights[numChanging++] = weights[i];
    }
    for (; numChanging % NEIGHBOURS_PER_PASS; numChanging++) {
      this.#valueOffsets[numChanging] = this.#valueOffsets[numChanging - 1];
      this.#weights[numChanging] = 0;
    }
    return numChanging;
  }

  #subtract(near: NeighbourSet, from: Float32Array, weights: Float64Array, begin: number, end: number): void {
    const sums = this.#sums;
    for (let c = begin; c < end; c++) {
      let sum = 0;
      for (let i = 0; i < weights.length; i++) sum += weights[i] * from[near.referenceRows[i] * NUM_CHANNELS + c];
      for (let k = c; k < sums.length; k += NUM_CHANNELS) sums[k] -= sum;
    }
  }

  /** Clamps scales and opacity to the range of the neighbours' changes. */
  #clampToNeighbours({ rows, referenceRows, kinds }: NeighbourSet): void {
    const { values, frames } = this,
      sums = this.#sums,
      lows = this.#lows.fill(Infinity),
      highs = this.#highs.fill(-Infinity);
    for (let i = 0; i < rows.length; i++) {
      const at = rows[i] * frames * NUM_CHANNELS,
        changed = kinds[i] & SHAPE;
      for (let c = FIRST_SHAPE; c < FIRST_COLOUR; c++) {
        const origin = this.referenceOffsets ? this.referenceOffsets[referenceRows[i] * NUM_CHANNELS + c] : 0;
        for (let k = c; k < sums.length; k += NUM_CHANNELS) {
          const value = changed ? values[at + k] - origin : 0;
          if (value < lows[k]) lows[k] = value;
          if (value > highs[k]) highs[k] = value;
        }
      }
    }
    for (let k = 0; k < sums.length; k += NUM_CHANNELS)
      for (let c = k + FIRST_SHAPE; c < k + FIRST_COLOUR; c++) sums[c] = Math.min(Math.max(sums[c], lows[c]), highs[c]);
  }

  /** Adds the part of the colour change that is proportional to the colour contrast. */
  #addContrast({ rows, referenceRows, kinds, contrasts }: NeighbourSet, contrast: Float64Array): void {
    const { values, frames } = this,
      sums = this.#sums,
      shares = this.#shares.fill(0);
    for (let i = 0; i < rows.length; i++) {
      if (!(kinds[i] & COLOUR)) continue;
      const x = contrasts[3 * i],
        y = contrasts[3 * i + 1],
        z = contrasts[3 * i + 2],
        from = referenceRows[i] * NUM_CHANNELS + FIRST_COLOUR,
        origin = this.referenceOffsets
          ? x * this.referenceOffsets[from] + y * this.referenceOffsets[from + 1] + z * this.referenceOffsets[from + 2]
          : 0;
      for (let frame = 0, at = rows[i] * frames * NUM_CHANNELS + FIRST_COLOUR; frame < frames; frame++) {
        shares[frame] += x * values[at] + y * values[at + 1] + z * values[at + 2] - origin;
        at += NUM_CHANNELS;
      }
    }
    for (let frame = 0, k = FIRST_COLOUR; frame < frames; frame++, k += NUM_CHANNELS) {
      const share = Math.min(Math.max(shares[frame], -1), 1);
      for (let a = 0; a < 3; a++) sums[k + a] += share * contrast[a];
    }
  }
}
