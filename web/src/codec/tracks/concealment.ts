// What tracks do whose motion was lost: what a quadratic through the motions of their neighbours says. The twin of
// `splatwire.clips.concealment`.

import { KdTree } from "../../conceal/kd_tree.ts";
import { DC, type Splats } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";
import { type Counts, changedKinds, FIRST_SHAPE, Sums } from "./neighbours.ts";

const NEIGHBOURS = 40,
  OPACITY = 9,
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
  /** Whether side information, too, does not tell when it is born in it. */
  readonly untold: (slot: number) => boolean;
  /** Step of a track's place. */
  readonly rounding: (slot: number) => number;
}

/**
 * What tracks `who` do, frames times channels each, as neighbours say whose motion arrived: rows `told`, which are
 * there in the whole group.
 */
export function guessed(arrived: Poses, told: Int32Array, who: Int32Array, past: Past, frames: number): Float32Array {
  const { together, fresh } = past,
    out = new Float32Array(frames * NUM_CHANNELS * who.length);
  who.forEach((slot, n) => {
    const start = past.since.subarray(slot * NUM_CHANNELS, (slot + 1) * NUM_CHANNELS);
    for (let frame = 0; frame < frames; frame++) out.set(start, (n * frames + frame) * NUM_CHANNELS);
  });
  const peers = told.filter((row) => together[arrived.slots[row]]),
    enough = peers.length >= NEIGHBOURS,
    wayOf = (slot: number) => (enough && together[slot] === 1 ? "alike" : fresh(slot) ? "fresh" : "old");
  for (const way of ["alike", "fresh", "old"]) {
    const asked = way === "alike" ? peers : told,
      at = Int32Array.from(who.keys()).filter((n) => wayOf(who[n]) === way);
    if (!at.length || !asked.length) continue;
    const field = new Field(arrived, asked, originsOf(way, arrived, asked, past, frames), past, frames);
    for (const n of at) {
      const own = out.subarray(n * frames * NUM_CHANNELS, (n + 1) * frames * NUM_CHANNELS);
      if (way === "alike") field.follow(who[n], own);
      else field.addChanges(who[n], own);
    }
  }
  if (told.length) fade(arrived, who, past, frames, out);
  return out;
}

/**
 * How neighbours differ from their bases where it is looked for them, and from where on their changes are told:
 * at their bases for tracks that were born with them, in the group's first frame for those that are born then, else
 * when the group before ended.
 */
function originsOf(way: string, arrived: Poses, told: Int32Array, past: Past, frames: number): Float32Array {
  const found = new Float32Array(told.length * NUM_CHANNELS);
  if (way === "alike") return found;
  told.forEach((row, n) => {
    const [values, at] = way === "fresh" ? [arrived.offsets, row * frames] : [past.since, arrived.slots[row]];
    found.set(values.subarray(at * NUM_CHANNELS, (at + 1) * NUM_CHANNELS), n * NUM_CHANNELS);
  });
  return found;
}

/** When a track is born is in its motion: while nobody tells, it is drawn by the odds that it is there. */
function fade(arrived: Poses, who: Int32Array, { untold }: Past, frames: number, out: Float32Array): void {
  const begins = arrived.begins.filter((_, n) => untold(arrived.slots[n]));
  if (!begins.length) return;
  for (let frame = 0; frame < frames; frame++) {
    const share = begins.filter((begin) => begin <= frame).length / begins.length,
      log = Math.log(Math.max(share, UNLIKELY));
    who.forEach((slot, n) => {
      if (untold(slot)) out[(n * frames + frame) * NUM_CHANNELS + OPACITY] += log;
    });
  }
}

/** What some tracks do, asked at the place of another. */
class Field {
  readonly #tree: KdTree;
  readonly #here = new Float32Array(3);
  readonly #offsets: Float64Array;
  /** Of the neighbours of the last track: which of those told, their rows, their slots. */
  readonly #near: Int32Array;
  readonly #rows: Int32Array;
  readonly #slots: Int32Array;
  readonly #counts: Counts;
  readonly #contrast = new Float64Array(3);
  readonly #kinds: Uint8Array;
  readonly #before = new Sums(1);
  readonly #now: Sums;

  constructor(
    readonly arrived: Poses,
    readonly told: Int32Array,
    readonly origins: Float32Array,
    readonly past: Past,
    readonly frames: number,
  ) {
    const points = new Float32Array(3 * told.length),
      count = Math.min(NEIGHBOURS, told.length);
    told.forEach((row, n) => {
      for (let a = 0; a < 3; a++)
        points[3 * n + a] = past.splats.means[3 * arrived.slots[row] + a] + origins[n * NUM_CHANNELS + a];
    });
    this.#tree = new KdTree(points, count);
    this.#offsets = new Float64Array(3 * count);
    this.#near = new Int32Array(count);
    this.#rows = new Int32Array(count);
    this.#slots = new Int32Array(count);
    this.#counts = {
      weights: new Float64Array(count),
      closeness: new Float64Array(count),
      contrasts: new Float64Array(3 * count),
    };
    this.#kinds = changedKinds(arrived.offsets, told, arrived.slots.length, frames * NUM_CHANNELS);
    this.#now = new Sums(frames);
  }

  /** What neighbours do, and how the track differed from that; of what is not large beside its steps the less. */
  follow(slot: number, out: Float32Array): void {
    const { since, guessed, rounding } = this.past,
      own = new Float32Array(NUM_CHANNELS);
    this.#ask(slot, 0);
    this.#before.of(since, this.#slots, null, this.#counts, this.#contrast, own);
    let apart = 0;
    for (let c = 0; c < NUM_CHANNELS; c++) own[c] = since[slot * NUM_CHANNELS + c] - own[c];
    for (let a = 0; a < 3; a++) apart += own[a] * own[a];
    const trust = guessed?.[slot] ? 0 : apart / (apart + rounding(slot) ** 2 + 1e-30);
    this.#now.of(this.arrived.offsets, this.#rows, this.#kinds, this.#counts, this.#contrast, out);
    for (let frame = 0; frame < this.frames; frame++)
      for (let c = 0; c < FIRST_SHAPE; c++) out[frame * NUM_CHANNELS + c] += trust * own[c];
  }

  /** Adds what neighbours changed. */
  addChanges(slot: number, out: Float32Array): void {
    const changed = new Float32Array(out.length);
    this.#ask(slot, 1);
    this.#now.of(this.#changes(), Int32Array.from(this.#rows.keys()), null, this.#counts, this.#contrast, changed);
    for (let k = 0; k < out.length; k++) out[k] += changed[k];
  }

  /** How neighbours differ from their origins, row by row. */
  #changes(): Float32Array {
    const stride = this.frames * NUM_CHANNELS,
      found = new Float32Array(this.#rows.length * stride);
    this.#rows.forEach((row, i) => {
      const origin = this.#near[i] * NUM_CHANNELS;
      for (let k = 0; k < stride; k++)
        found[i * stride + k] = this.arrived.offsets[row * stride + k] - this.origins[origin + (k % NUM_CHANNELS)];
    });
    return found;
  }

  /** Finds the neighbours of a track, and what they count; it is where it was last times `moved`. */
  #ask(slot: number, moved: number): void {
    const { weights, closeness, contrasts } = this.#counts,
      { points } = this.#tree,
      { splats, since } = this.past,
      offsets = this.#offsets,
      here = this.#here;
    for (let a = 0; a < 3; a++) here[a] = splats.means[3 * slot + a] + moved * since[slot * NUM_CHANNELS + a];
    const near = this.#tree.nearest(here[0], here[1], here[2]);
    for (let i = 0; i < near.length; i++) {
      for (let a = 0; a < 3; a++) offsets[3 * i + a] = points[3 * near[i] + a] - here[a];
      this.#near[i] = near[i];
      this.#rows[i] = this.told[near[i]];
      this.#slots[i] = this.arrived.slots[this.#rows[i]];
    }
    const unit = closenessOf(offsets, closeness);
    smoothWeights(offsets, closeness, unit, weights);
    this.#compare(slot, closeness, contrasts);
  }

  /** How colours of neighbours, and that of the track, differ from their mean. */
  #compare(slot: number, closeness: Float64Array, contrasts: Float64Array): void {
    const { colours } = this.past.splats,
      slots = this.#slots,
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

/** How near neighbours at these offsets are, adds up to one; returns their mean distance. */
function closenessOf(offsets: Float64Array, out: Float64Array): number {
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

const POWERS = new Float64Array(TERMS * NEIGHBOURS),
  MOMENTS = new Float64Array(TERMS * TERMS);

/** Weights of neighbours at these offsets: of the quadratic that fits best, near ones counting more. */
function smoothWeights(offsets: Float64Array, near: Float64Array, unit: number, out: Float64Array): void {
  const count = near.length;
  MOMENTS.fill(0);
  for (let m = 0; m < count; m++) {
    powersOf(offsets[3 * m] / unit, offsets[3 * m + 1] / unit, offsets[3 * m + 2] / unit, POWERS, TERMS * m);
    for (let a = 0; a < TERMS; a++) {
      const own = near[m] * POWERS[TERMS * m + a];
      for (let b = 0; b <= a; b++) MOMENTS[TERMS * a + b] += own * POWERS[TERMS * m + b];
    }
  }
  for (let a = 0; a < TERMS; a++) MOMENTS[(TERMS + 1) * a] += RIDGES[a];
  const here = solvedForFirst(MOMENTS);
  let total = 0;
  for (let m = 0; m < count; m++) {
    let value = 0;
    for (let a = 0; a < TERMS; a++) value += POWERS[TERMS * m + a] * here[a];
    total += out[m] = near[m] * value;
  }
  let sum = 0;
  for (let m = 0; m < count; m++) sum += Math.abs((out[m] /= total));
  if (sum > WILD) out.set(near);
}

/** What a quadratic adds up, at a place. */
function powersOf(x: number, y: number, z: number, out: Float64Array, at: number): void {
  out[at] = 1;
  out[at + 1] = x;
  out[at + 2] = y;
  out[at + 3] = z;
  out[at + 4] = x * x;
  out[at + 5] = y * y;
  out[at + 6] = z * z;
  out[at + 7] = x * y;
  out[at + 8] = x * z;
  out[at + 9] = y * z;
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
