// What neighbours do, weighed: one neighbour after another, of each what changes at all.

import { NUM_CHANNELS } from "./layout.ts";

/** Channels of place and rotation are the first; those of scale and opacity begin here, and those of colour. */
export const FIRST_SHAPE = 6,
  FIRST_COLOUR = 10;

/** Kinds of channels in which a row changes, as bits. */
const POSE = 1,
  SHAPE = 2,
  COLOUR = 4,
  ALL = POSE | SHAPE | COLOUR;

/** In which kinds of channels some rows of so many values change: others add nothing. */
export function changedKinds(values: Float32Array, rows: Int32Array, count: number, stride: number): Uint8Array {
  const kinds = new Uint8Array(count);
  for (const row of rows) {
    let found = 0;
    for (let at = row * stride; at < (row + 1) * stride && found < ALL; at += NUM_CHANNELS) {
      if (changes(values, at, at + FIRST_SHAPE)) found |= POSE;
      if (changes(values, at + FIRST_SHAPE, at + FIRST_COLOUR)) found |= SHAPE;
      if (changes(values, at + FIRST_COLOUR, at + NUM_CHANNELS)) found |= COLOUR;
    }
    kinds[row] = found;
  }
  return kinds;
}

function changes(values: Float32Array, begin: number, end: number): boolean {
  for (let at = begin; at < end; at++) if (values[at]) return true;
  return false;
}

/** How much a neighbour counts: for place, turn and shape, for colour, and by how its colour differs. */
export interface Counts {
  readonly weights: Float64Array;
  readonly closeness: Float64Array;
  readonly contrasts: Float64Array;
}

/** Sums over neighbours, of so many frames. */
export class Sums {
  readonly #sums: Float64Array;
  readonly #lows: Float64Array;
  readonly #highs: Float64Array;
  readonly #shares: Float64Array;

  constructor(readonly frames: number) {
    this.#sums = new Float64Array(frames * NUM_CHANNELS);
    this.#lows = new Float64Array(frames * NUM_CHANNELS);
    this.#highs = new Float64Array(frames * NUM_CHANNELS);
    this.#shares = new Float64Array(frames);
  }

  /**
   * What neighbours say of a track whose colour differs by `contrast` from theirs.
   *
   * @param values Frames times channels of each row.
   * @param rows Of the neighbours.
   * @param kinds See `changedKinds`; null where all may change.
   */
  of(
    values: Float32Array,
    rows: Int32Array,
    kinds: Uint8Array | null,
    { weights, closeness, contrasts }: Counts,
    contrast: Float64Array,
    out: Float32Array,
  ): void {
    const stride = this.frames * NUM_CHANNELS,
      bounded = kinds && rows.some((row) => !(kinds[row] & SHAPE)) ? 0 : Infinity;
    this.#sums.fill(0);
    this.#lows.fill(bounded);
    this.#highs.fill(-bounded);
    this.#shares.fill(0);
    for (let i = 0; i < rows.length; i++) {
      const at = rows[i] * stride,
        changed = kinds ? kinds[rows[i]] : ALL;
      if (changed & POSE) this.#addPose(values, at, weights[i]);
      if (changed & SHAPE) this.#addShape(values, at, weights[i]);
      if (changed & COLOUR) this.#addColour(values, at, closeness[i], contrasts, 3 * i);
    }
    this.#tell(contrast, out);
  }

  #addPose(values: Float32Array, from: number, weight: number): void {
    const sums = this.#sums;
    for (let k = 0; k < sums.length; k += NUM_CHANNELS)
      for (let c = k; c < k + FIRST_SHAPE; c++) sums[c] += weight * values[from + c];
  }

  #addShape(values: Float32Array, from: number, weight: number): void {
    const sums = this.#sums,
      lows = this.#lows,
      highs = this.#highs;
    for (let k = 0; k < sums.length; k += NUM_CHANNELS) {
      for (let c = k + FIRST_SHAPE; c < k + FIRST_COLOUR; c++) {
        const value = values[from + c];
        sums[c] += weight * value;
        if (value < lows[c]) lows[c] = value;
        if (value > highs[c]) highs[c] = value;
      }
    }
  }

  #addColour(values: Float32Array, from: number, near: number, contrasts: Float64Array, own: number): void {
    const sums = this.#sums,
      shares = this.#shares;
    for (let k = FIRST_COLOUR, frame = 0; k < sums.length; k += NUM_CHANNELS, frame++) {
      for (let a = 0; a < 3; a++) {
        const value = values[from + k + a];
        sums[k + a] += near * value;
        shares[frame] += contrasts[own + a] * value;
      }
    }
  }

  #tell(contrast: Float64Array, out: Float32Array): void {
    const sums = this.#sums;
    for (let frame = 0, k = 0; frame < this.frames; frame++) {
      const share = Math.min(Math.max(this.#shares[frame], -1), 1);
      for (let c = 0; c < NUM_CHANNELS; c++, k++) {
        if (c < FIRST_SHAPE) out[k] = sums[k];
        // none grows or shines more than all around it
        else if (c < FIRST_COLOUR) out[k] = Math.min(Math.max(sums[k], this.#lows[k]), this.#highs[k]);
        else out[k] = sums[k] + share * contrast[c - FIRST_COLOUR];
      }
    }
  }
}
