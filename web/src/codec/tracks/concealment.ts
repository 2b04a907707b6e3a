// What tracks do whose motion was lost: what a quadratic through the motions of their neighbours says. The twin of
// `splatwire.clips.guessing`.

import { KdTree } from "../../conceal/kd_tree.ts";
import { Field, NEIGHBOURS } from "./field.ts";
import { NUM_CHANNELS } from "./layout.ts";
import type { Past, Poses } from "./poses.ts";

const OPACITY = 9,
  /** Least share of its opacity that is drawn of what may not be born yet. */
  UNLIKELY = 1e-3,
  /** Neighbours that say whether tracks move as those around them; of so many tracks; every so manieth is asked. */
  AROUND = 8,
  MOST_AROUND = 4096,
  ASKED = 8,
  /** Part of its squared motion by which a track may differ from them. */
  ALIKE = 0.25;

/**
 * What tracks `who` do, frames times channels each, as neighbours say whose motion arrived: rows `told`, which are
 * there in the whole group.
 */
export function guessed(arrived: Poses, told: Int32Array, who: Int32Array, past: Past, frames: number): Float32Array {
  const { together, fresh } = past,
    out = new Float32Array(frames * NUM_CHANNELS * who.length);
  const peers = told.filter((row) => together[arrived.slots[row]]),
    enough = peers.length >= NEIGHBOURS,
    wayOf = (slot: number) => (enough && together[slot] === 1 ? "alike" : fresh(slot) ? "fresh" : "old");
  who.forEach((slot, n) => {
    if (!told.length || wayOf(slot) !== "alike") stay(past.since, slot, out, n * frames, frames);
  });
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
 * Whether most tracks move as those around them: of those that arrived, rows `told`, some are asked. Where they do not,
 * a guess is worse than nothing.
 */
export function believed(arrived: Poses, told: Int32Array, means: Float32Array, frames: number): boolean {
  if (told.length <= 2 * AROUND) return true;
  const each = Math.ceil(told.length / MOST_AROUND),
    rows = told.filter((_, n) => n % each === 0),
    value = (n: number, frame: number, a: number) =>
      arrived.offsets[(rows[n] * frames + frame) * NUM_CHANNELS + a] -
      arrived.offsets[rows[n] * frames * NUM_CHANNELS + a],
    points = Float32Array.from({ length: 3 * rows.length }, (_, k) => {
      const row = rows[Math.floor(k / 3)];
      return means[3 * arrived.slots[row] + (k % 3)] + arrived.offsets[row * frames * NUM_CHANNELS + (k % 3)];
    }),
    tree = new KdTree(points, AROUND);
  let alike = 0;
  for (let n = 0; n < rows.length; n += ASKED) {
    const near = tree.nearestOthers(n);
    let moved = 0,
      apart = 0;
    for (let k = 3; k < 3 * frames; k++) {
      const own = value(n, Math.floor(k / 3), k % 3);
      let said = 0;
      for (const other of near) said += value(other, Math.floor(k / 3), k % 3) / near.length;
      moved += own * own;
      apart += (own - said) ** 2;
    }
    alike += apart <= ALIKE * moved ? 1 : -1;
  }
  return alike > 0;
}

/** A track differs from its base in all frames, from `to` on, as it did. */
function stay(since: Float32Array, slot: number, out: Float32Array, to: number, frames: number): void {
  for (let k = to * NUM_CHANNELS; k < (to + frames) * NUM_CHANNELS; k++)
    out[k] = since[slot * NUM_CHANNELS + (k % NUM_CHANNELS)];
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
  const some = Int32Array.from(who.keys()).filter((n) => untold(who[n]));
  for (let frame = 0; frame < frames; frame++) {
    const share = begins.reduce((sum, begin) => sum + Number(begin <= frame), 0) / begins.length;
    if (share === 1) return; // as from then on
    for (const n of some) out[(n * frames + frame) * NUM_CHANNELS + OPACITY] += Math.log(Math.max(share, UNLIKELY));
  }
}
