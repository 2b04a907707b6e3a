// What tracks do whose motion was lost: what a quadratic through the motions of their neighbours says. The twin of
// `splatwire.clips.concealment`.

import { KdTree } from "../../conceal/kd_tree.ts";
import { DC, type Splats } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";

const NEIGHBOURS = 40,
  /** Channels of scale and opacity begin here, and those of colour. */
  FIRST_SHAPE = 6,
  OPACITY = 9,
  FIRST_COLOUR = 10,
  /** Least share of its opacity that is drawn of what may not be born yet. */
  UNLIKELY = 1e-3,
  NEAREST = 0.1,
  TERMS = 10,
  RIDGES = [1e-9, 1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2],
  /** Squared contrast of colours of which a change that grows with it is half believed. */
  COLOUR_RIDGE = 0.1 * DC * DC,
  /** A fit whose weights add up to more reaches too far out of its neighbours: their mean is safer. */
  WILD = 6;

/** How tracks of a group differ from their bases; n tracks, frames times channels each. */
export interface Poses {
  /** Slot of each track. */
  readonly slots: Int32Array;
  /** First frame in the group, and the first after. */
  readonly begins: Int32Array;
  readonly ends: Int32Array;
  readonly offsets: Float32Array;
}

/** What is known of tracks before a group, by slot. */
export interface Past {
  readonly splats: Splats;
  /** How each differed from its base in the last frame. */
  readonly since: Float32Array;
  /** Whether that was a guess. */
  readonly guessed: Uint8Array | null;
  /** Whether a track was born in the group that most were: offsets of others are from another time on. */
  readonly together: Uint8Array;
  /** Whether a track is born in the group. */
  readonly fresh: (slot: number) => boolean;
  /** Step of a track's place. */
  readonly rounding: (slot: number) => number;
}

/**
 * What tracks `who` do, frames times channels each, as neighbours say whose motion arrived: rows `told`, which are
 * there in the whole group.
 */
export function guessed(arrived: Poses, told: Int32Array, who: Int32Array, past: Past, frames: number): Float32Array {
  const { together } = past,
    out = new Float32Array(frames * NUM_CHANNELS * who.length);
  who.forEach((slot, n) => {
    const start = past.since.subarray(slot * NUM_CHANNELS, (slot + 1) * NUM_CHANNELS);
    for (let frame = 0; frame < frames; frame++) out.set(start, (n * frames + frame) * NUM_CHANNELS);
  });
  const peers = told.filter((row) => together[arrived.slots[row]]),
    enough = peers.length >= NEIGHBOURS;
  for (const alike of [true, false]) {
    const asked = alike ? peers : told,
      at = Int32Array.from(who.keys()).filter((n) => (enough && together[who[n]] === 1) === alike);
    if (!at.length || !asked.length) continue;
    const field = new Field(arrived, asked, past, frames);
    for (const n of at) {
      const own = out.subarray(n * frames * NUM_CHANNELS, (n + 1) * frames * NUM_CHANNELS);
      if (alike) field.follow(who[n], own);
      else field.addChanges(who[n], own);
    }
  }
  if (told.length) fade(arrived, who, past, frames, out);
  return out;
}

/** When a track is born is in its motion: while that is lost, it is drawn by the odds that it is there. */
function fade(arrived: Poses, who: Int32Array, { fresh }: Past, frames: number, out: Float32Array): void {
  const begins = arrived.begins.filter((_, n) => fresh(arrived.slots[n]));
  if (!begins.length) return;
  for (let frame = 0; frame < frames; frame++) {
    const share = begins.filter((begin) => begin <= frame).length / begins.length,
      log = Math.log(Math.max(share, UNLIKELY));
    who.forEach((slot, n) => {
      if (fresh(slot)) out[(n * frames + frame) * NUM_CHANNELS + OPACITY] += log;
    });
  }
}

/** What some tracks do, asked at the place of another. */
class Field {
  readonly #tree: KdTree;
  readonly #count: number;
  readonly #here = new Float32Array(3);
  readonly #near: Int32Array;
  readonly #rows: Int32Array;
  readonly #slots: Int32Array;
  readonly #weights: Float64Array;
  readonly #closeness: Float64Array;
  readonly #contrasts: Float64Array;
  readonly #contrast = new Float64Array(3);

  constructor(
    readonly arrived: Poses,
    readonly told: Int32Array,
    readonly past: Past,
    readonly frames: number,
  ) {
    const points = new Float32Array(3 * told.length),
      count = Math.min(NEIGHBOURS, told.length);
    told.forEach((row, n) => this.#place(arrived.slots[row], points, 3 * n));
    this.#tree = new KdTree(points, count);
    this.#count = count;
    this.#near = new Int32Array(count);
    this.#rows = new Int32Array(count);
    this.#slots = new Int32Array(count);
    this.#weights = new Float64Array(count);
    this.#closeness = new Float64Array(count);
    this.#contrasts = new Float64Array(3 * count);
  }

  /** What neighbours do, and how the track differed from that; of what is not large beside its steps the less. */
  follow(slot: number, out: Float32Array): void {
    const { since, guessed, rounding } = this.past,
      own = new Float32Array(NUM_CHANNELS);
    this.#ask(slot);
    this.#say(since, this.#slots, 1, null, own);
    let apart = 0;
    for (let c = 0; c < NUM_CHANNELS; c++) own[c] = since[slot * NUM_CHANNELS + c] - own[c];
    for (let a = 0; a < 3; a++) apart += own[a] * own[a];
    const trust = guessed?.[slot] ? 0 : apart / (apart + rounding(slot) ** 2 + 1e-30);
    this.#say(this.arrived.offsets, this.#rows, this.frames, null, out);
    for (let frame = 0; frame < this.frames; frame++)
      for (let c = 0; c < FIRST_SHAPE; c++) out[frame * NUM_CHANNELS + c] += trust * own[c];
  }

  /** Adds what neighbours changed. */
  addChanges(slot: number, out: Float32Array): void {
    const changes = new Float32Array(out.length);
    this.#ask(slot);
    this.#say(this.arrived.offsets, this.#rows, this.frames, this.past.since, changes);
    for (let k = 0; k < out.length; k++) out[k] += changes[k];
  }

  #place(slot: number, out: Float32Array, at: number): void {
    const { splats, since } = this.past;
    for (let a = 0; a < 3; a++) out[at + a] = splats.means[3 * slot + a] + since[slot * NUM_CHANNELS + a];
  }

  /** Finds the neighbours of a track, and what they count. */
  #ask(slot: number): void {
    const count = this.#count,
      { points } = this.#tree,
      { colours } = this.past.splats,
      offsets = new Float64Array(3 * count),
      mean = [0, 0, 0];
    this.#place(slot, this.#here, 0);
    this.#near.set(this.#tree.nearest(this.#here[0], this.#here[1], this.#here[2]));
    for (let i = 0; i < count; i++)
      for (let a = 0; a < 3; a++) offsets[3 * i + a] = points[3 * this.#near[i] + a] - this.#here[a];
    const unit = closeness(offsets, this.#closeness);
    this.#weights.set(smoothWeights(offsets, this.#closeness, unit));
    const slots = this.#slots;
    for (let i = 0; i < count; i++) {
      this.#rows[i] = this.told[this.#near[i]];
      slots[i] = this.arrived.slots[this.#rows[i]];
    }
    slots.forEach((other, i) => {
      for (let a = 0; a < 3; a++) mean[a] += this.#closeness[i] * colours[3 * other + a];
    });
    let square = COLOUR_RIDGE;
    slots.forEach((other, i) => {
      for (let a = 0; a < 3; a++) {
        const apart = colours[3 * other + a] - mean[a];
        square += this.#closeness[i] * apart * apart;
        this.#contrasts[3 * i + a] = this.#closeness[i] * apart;
      }
    });
    for (let k = 0; k < 3 * count; k++) this.#contrasts[k] /= square;
    for (let a = 0; a < 3; a++) this.#contrast[a] = colours[3 * slot + a] - mean[a];
  }

  /** What the neighbours' values (by rows of so many frames, less what is by slot) say of the track. */
  #say(values: Float32Array, rows: Int32Array, frames: number, less: Float32Array | null, out: Float32Array): void {
    const count = this.#count,
      stride = frames * NUM_CHANNELS,
      slots = this.#slots;
    for (let frame = 0; frame < frames; frame++) {
      let share = 0;
      for (let c = 0; c < NUM_CHANNELS; c++) {
        const k = frame * NUM_CHANNELS + c,
          coloured = c >= FIRST_COLOUR,
          weights = coloured ? this.#closeness : this.#weights;
        let sum = 0,
          low = Infinity,
          high = -Infinity;
        for (let i = 0; i < count; i++) {
          const value = values[rows[i] * stride + k] - (less ? less[slots[i] * NUM_CHANNELS + c] : 0);
          sum += weights[i] * value;
          if (value < low) low = value;
          if (value > high) high = value;
          if (coloured) share += this.#contrasts[3 * i + c - FIRST_COLOUR] * value;
        }
        // none grows or shines more than all around it
        out[k] = c >= FIRST_SHAPE && !coloured ? Math.min(Math.max(sum, low), high) : sum;
      }
      share = Math.min(Math.max(share, -1), 1);
      for (let a = 0; a < 3; a++) out[frame * NUM_CHANNELS + FIRST_COLOUR + a] += share * this.#contrast[a];
    }
  }
}

/** How near neighbours at these offsets are, adds up to one; returns their mean distance. */
export function closeness(offsets: Float64Array, out: Float64Array): number {
  const count = out.length;
  let mean = 1e-30,
    total = 0;
  for (let m = 0; m < 3 * count; m++) mean += offsets[m] ** 2 / count;
  for (let m = 0; m < count; m++) {
    const square = offsets[3 * m] ** 2 + offsets[3 * m + 1] ** 2 + offsets[3 * m + 2] ** 2;
    total += out[m] = 1 / (square / mean + NEAREST);
  }
  for (let m = 0; m < count; m++) out[m] /= total;
  return Math.sqrt(mean);
}

/** Weights of neighbours at these offsets: of the quadratic that fits best, near ones counting more. */
export function smoothWeights(offsets: Float64Array, near: Float64Array, unit: number): Float64Array {
  const count = near.length,
    terms = new Float64Array(TERMS * count),
    moments = new Float64Array(TERMS * TERMS);
  for (let m = 0; m < count; m++) {
    const x = offsets[3 * m] / unit,
      y = offsets[3 * m + 1] / unit,
      z = offsets[3 * m + 2] / unit;
    terms.set([1, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z], TERMS * m);
    for (let a = 0; a < TERMS; a++)
      for (let b = 0; b <= a; b++) moments[TERMS * a + b] += near[m] * terms[TERMS * m + a] * terms[TERMS * m + b];
  }
  for (let a = 0; a < TERMS; a++) moments[(TERMS + 1) * a] += RIDGES[a];
  const here = solvedForFirst(moments);
  let total = 0;
  const weights = near.map((closeness, m) => {
    let value = 0;
    for (let a = 0; a < TERMS; a++) value += terms[TERMS * m + a] * here[a];
    total += closeness * value;
    return closeness * value;
  });
  let sum = 0;
  for (let m = 0; m < count; m++) sum += Math.abs((weights[m] /= total));
  return sum > WILD ? near : weights;
}

/** The first column of the inverse of a symmetric positive matrix whose lower half is given (Cholesky). */
function solvedForFirst(lower: Float64Array): Float64Array {
  const x = new Float64Array(TERMS);
  for (let a = 0; a < TERMS; a++) {
    for (let b = 0; b <= a; b++) {
      let sum = lower[TERMS * a + b];
      for (let k = 0; k < b; k++) sum -= lower[TERMS * a + k] * lower[TERMS * b + k];
      lower[TERMS * a + b] = a === b ? Math.sqrt(sum) : sum / lower[(TERMS + 1) * b];
    }
  }
  for (let a = 0; a < TERMS; a++) {
    let sum = a ? 0 : 1;
    for (let k = 0; k < a; k++) sum -= lower[TERMS * a + k] * x[k];
    x[a] = sum / lower[(TERMS + 1) * a];
  }
  for (let a = TERMS - 1; a >= 0; a--) {
    let sum = x[a];
    for (let k = a + 1; k < TERMS; k++) sum -= lower[TERMS * k + a] * x[k];
    x[a] = sum / lower[(TERMS + 1) * a];
  }
  return x;
}
