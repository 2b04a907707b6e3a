// Estimates the motion of tracks with lost motion by a quadratic fit to the motion of their neighbours. Counterpart of
// `splatwire.concealment.temporal.extrapolation`.

import { NUM_CHANNELS } from "./layout.ts";
import { MotionField, NEIGHBOURS } from "./motion_field.ts";
import type { PreviousState, TrackOffsets } from "./poses.ts";

const OPACITY = 9,
  /** Least factor of opacity for tracks that may not exist yet. */
  MIN_FADE = 1e-3;

/**
 * Returns the offsets of the tracks `queryTracks`, shape (tracks, frames, channels). Prediction uses neighbours among
 * `observedRows`, the rows with received motion for the whole group. `bornTogether` marks the tracks born in the same
 * group as most of the received ones (1), by slot. Offsets of others refer to another time.
 */
export function extrapolate(
  arrived: TrackOffsets,
  observedRows: Int32Array,
  queryTracks: Int32Array,
  bornTogether: Uint8Array,
  past: PreviousState,
  frames: number,
): Float32Array {
  const { isNew } = past,
    out = new Float32Array(frames * NUM_CHANNELS * queryTracks.length);
  const peers = observedRows.filter((row) => bornTogether[arrived.slots[row]]),
    enough = peers.length >= NEIGHBOURS,
    caseOf = (slot: number) => (enough && bornTogether[slot] === 1 ? "alike" : isNew(slot) ? "fresh" : "old");
  queryTracks.forEach((slot, n) => {
    if (!observedRows.length || caseOf(slot) !== "alike")
      repeatLastOffset(past.lastOffsets, slot, out, n * frames, frames);
  });
  for (const way of ["alike", "fresh", "old"]) {
    const sources = way === "alike" ? peers : observedRows,
      at = Int32Array.from(queryTracks.keys()).filter((n) => caseOf(queryTracks[n]) === way);
    if (!at.length || !sources.length) continue;
    const field = new MotionField(arrived, sources, motionOrigins(way, arrived, sources, past, frames), past, frames);
    for (const n of at) {
      const own = out.subarray(n * frames * NUM_CHANNELS, (n + 1) * frames * NUM_CHANNELS);
      if (way === "alike") field.predict(queryTracks[n], own);
      else field.addChanges(queryTracks[n], own);
    }
  }
  if (observedRows.length) fadeIn(arrived, queryTracks, past, frames, out);
  return out;
}

/** Repeats a track's last offset in all frames, written from frame index `to`. */
export function repeatLastOffset(
  since: Float32Array,
  slot: number,
  out: Float32Array,
  to: number,
  frames: number,
): void {
  for (let k = to * NUM_CHANNELS; k < (to + frames) * NUM_CHANNELS; k++)
    out[k] = since[slot * NUM_CHANNELS + (k % NUM_CHANNELS)];
}

/**
 * Returns the reference offsets of the neighbours' motion, by case: 0 for tracks born together (`alike`), the first
 * frame of this group for new tracks (`fresh`), the end of the group before otherwise.
 */
function motionOrigins(
  way: string,
  arrived: TrackOffsets,
  observedRows: Int32Array,
  past: PreviousState,
  frames: number,
): Float32Array {
  const found = new Float32Array(observedRows.length * NUM_CHANNELS);
  if (way === "alike") return found;
  observedRows.forEach((row, n) => {
    const [values, at] = way === "fresh" ? [arrived.offsets, row * frames] : [past.lastOffsets, arrived.slots[row]];
    found.set(values.subarray(at * NUM_CHANNELS, (at + 1) * NUM_CHANNELS), n * NUM_CHANNELS);
  });
  return found;
}

/**
 * Fades in tracks with an unknown first frame. Their opacity is multiplied by the share of similar tracks that exist in
 * each frame.
 */
function fadeIn(
  arrived: TrackOffsets,
  queryTracks: Int32Array,
  { hasUnknownBirth }: PreviousState,
  frames: number,
  out: Float32Array,
): void {
  const begins = arrived.begins.filter((_, n) => hasUnknownBirth(arrived.slots[n]));
  if (!begins.length) return;
  const some = Int32Array.from(queryTracks.keys()).filter((n) => hasUnknownBirth(queryTracks[n]));
  for (let frame = 0; frame < frames; frame++) {
    const share = begins.reduce((sum, begin) => sum + Number(begin <= frame), 0) / begins.length;
    if (share === 1) return; // the share is 1 in all later frames
    for (const n of some) out[(n * frames + frame) * NUM_CHANNELS + OPACITY] += Math.log(Math.max(share, MIN_FADE));
  }
}
