// What tracks do whose motion arrived, asked at the place of another: its nearest neighbours among them say.

import { KdTree } from "../../conceal/kd_tree.ts";
import { DC } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";
import { COLOUR, changedKinds, FIRST_SHAPE, type Near, POSE, SHAPE, Sums } from "./neighbours.ts";
import type { Past, Poses } from "./poses.ts";
import { closenessOf, Quadratic } from "./quadratic.ts";

export const NEIGHBOURS = 40;
/** Squared contrast of colours of which a change that grows with it is half believed. */
const COLOUR_RIDGE = 0.1 * DC * DC;

/** What some tracks do. */
export class Field {
  readonly #tree: KdTree;
  readonly #fit: Quadratic;
  readonly #now: Sums;
  readonly #before: Sums;
  /** In what those told change, and in what they differed from their bases before. */
  readonly #kinds: Uint8Array;
  readonly #had: Uint8Array;
  /** Neighbours of the last track: their rows; the same by slots, as they were before; where they are from it. */
  readonly #near: Near;
  readonly #last: Near;
  readonly #offsets: Float64Array;
  readonly #contrast = new Float64Array(3);
  readonly #own = new Float32Array(NUM_CHANNELS);
  readonly #found: Float32Array;

  /** Rows `told` of what arrived are asked where `origins` put them, and tell how they changed from there. */
  constructor(
    readonly arrived: Poses,
    readonly told: Int32Array,
    readonly origins: Float32Array,
    readonly past: Past,
    readonly frames: number,
  ) {
    const points = new Float32Array(3 * told.length),
      count = Math.min(NEIGHBOURS, told.length),
      slots = told.map((row) => arrived.slots[row]),
      from = changedKinds(origins, Int32Array.from(told.keys()), NUM_CHANNELS),
      still = from.every((kind) => !kind);
    for (let n = 0; n < told.length; n++)
      for (let a = 0; a < 3; a++)
        points[3 * n + a] = past.splats.means[3 * slots[n] + a] + origins[n * NUM_CHANNELS + a];
    this.#tree = new KdTree(points, count);
    this.#fit = new Quadratic(count);
    this.#now = new Sums(frames, count, arrived.offsets, still ? null : origins);
    this.#before = new Sums(1, count, past.since, null);
    this.#kinds = changedKinds(arrived.offsets, told, frames * NUM_CHANNELS).map((kind, n) => kind | from[n]);
    this.#had = changedKinds(past.since, slots, NUM_CHANNELS);
    this.#near = nobody(count);
    this.#last = { ...this.#near, rows: new Int32Array(count), kinds: new Uint8Array(count) };
    this.#offsets = new Float64Array(3 * count);
    this.#found = new Float32Array(frames * NUM_CHANNELS);
  }

  /** What neighbours do, and how the track differed from that; of what is not large beside its steps the less. */
  follow(slot: number, out: Float32Array): void {
    const { since, guessed, rounding } = this.past,
      own = this.#own,
      changed = this.#find(slot, 0),
      had = anyOf(this.#last.kinds) & POSE;
    this.#weigh(slot, changed | had);
    this.#now.of(this.#near, changed, this.#contrast, out);
    if (guessed?.[slot]) return;
    this.#before.of(this.#last, had, this.#contrast, own);
    let apart = 0;
    for (let c = 0; c < FIRST_SHAPE; c++) own[c] = since[slot * NUM_CHANNELS + c] - own[c];
    for (let a = 0; a < 3; a++) apart += own[a] * own[a];
    if (!apart) return;
    const trust = apart / (apart + rounding(slot) ** 2 + 1e-30);
    for (let frame = 0; frame < this.frames; frame++)
      for (let c = 0; c < FIRST_SHAPE; c++) out[frame * NUM_CHANNELS + c] += trust * own[c];
  }

  /** Adds what neighbours changed. */
  addChanges(slot: number, out: Float32Array): void {
    const found = this.#found,
      changed = this.#find(slot, 1);
    this.#weigh(slot, changed);
    this.#now.of(this.#near, changed, this.#contrast, found);
    for (let k = 0; k < out.length; k++) out[k] += found[k];
  }

  /** Finds the neighbours of a track, which is where it was last times `moved`; returns in what they change. */
  #find(slot: number, moved: number): number {
    const { told, arrived, past } = this,
      { points } = this.#tree,
      { means } = past.splats,
      here = this.#own,
      offsets = this.#offsets,
      { rows, origins, kinds } = this.#near,
      last = this.#last;
    for (let a = 0; a < 3; a++) here[a] = means[3 * slot + a] + moved * past.since[slot * NUM_CHANNELS + a];
    const near = this.#tree.nearest(here[0], here[1], here[2]);
    for (let i = 0; i < near.length; i++) {
      const n = near[i],
        row = told[n];
      for (let a = 0; a < 3; a++) offsets[3 * i + a] = points[3 * n + a] - here[a];
      rows[i] = row;
      origins[i] = n;
      kinds[i] = this.#kinds[n];
      last.rows[i] = arrived.slots[row];
      last.kinds[i] = this.#had[n];
    }
    return anyOf(kinds);
  }

  /** How much the neighbours count, as far as that is asked where they change in this. */
  #weigh(slot: number, changed: number): void {
    const { closeness, weights } = this.#near;
    if (!changed) return;
    const unit = closenessOf(this.#offsets, closeness);
    if (changed & (POSE | SHAPE)) this.#fit.weights(this.#offsets, closeness, unit, weights);
    if (changed & COLOUR) this.#compare(slot);
  }

  /** How colours of neighbours, and that of the track, differ from their mean. */
  #compare(slot: number): void {
    const { colours } = this.past.splats,
      { closeness, contrasts } = this.#near,
      slots = this.#last.rows,
      mean = this.#contrast.fill(0);
    for (let i = 0; i < slots.length; i++)
      for (let a = 0; a < 3; a++) mean[a] += closeness[i] * colours[3 * slots[i] + a];
    let square = COLOUR_RIDGE;
    for (let i = 0; i < slots.length; i++) {
      for (let a = 0; a < 3; a++) {
        const apart = colours[3 * slots[i] + a] - mean[a];
        square += closeness[i] * apart * apart;
        contrasts[3 * i + a] = closeness[i] * apart;
      }
    }
    for (let k = 0; k < contrasts.length; k++) contrasts[k] /= square;
    for (let a = 0; a < 3; a++) this.#contrast[a] = colours[3 * slot + a] - mean[a];
  }
}

function nobody(count: number): Near {
  return {
    rows: new Int32Array(count),
    origins: new Int32Array(count),
    kinds: new Uint8Array(count),
    weights: new Float64Array(count),
    closeness: new Float64Array(count),
    contrasts: new Float64Array(3 * count),
  };
}

function anyOf(kinds: Uint8Array): number {
  let found = 0;
  for (let i = 0; i < kinds.length; i++) found |= kinds[i];
  return found;
}
