// Estimates the motion of tracks with lost motion by a quadratic fit to the motion of their neighbours. Counterpart of
// `splatwire.concealment.temporal.motion_prediction`.

import { NUM_CHANNELS } from "./layout.ts";
import { MotionField, NEIGHBOURS } from "./motion_field.ts";
import type { TrackOffsets, TrackProperties } from "./track_offsets.ts";

const OPACITY = 9,
  /** Least factor of opacity for tracks that may not exist yet. */
  MIN_FADE = 1e-3;

/** Predicts lost motion of a group from its received motion, as the concealer `motion` does. */
export class LostMotionPredictor {
  /** Motion fields by case and birth group. */
  readonly #fields = new Map<string, MotionField>();

  /**
   * `completeRows` are the rows with received motion for the whole group. `birthGroups` are the groups that tracks are
   * born in, by arrival index.
   */
  constructor(
    readonly received: TrackOffsets,
    readonly completeRows: Int32Array,
    readonly birthGroups: Int32Array,
    readonly trackProperties: TrackProperties,
    readonly frames: number,
  ) {}

  /**
   * Returns the offsets of the tracks with the arrival indices `lostTracks`, in this order, shape (lostTracks, frames,
   * channels). Rows with 1 in `leftOut` are not used. Tracks that are born in the same group as most of the received
   * ones are predicted from these, because offsets of others refer to another time.
   */
  predict(leftOut: Uint8Array, lostTracks: Int32Array): Float32Array {
    const { received, trackProperties, frames, birthGroups } = this,
      { arrivalIndices } = received,
      out = new Float32Array(frames * NUM_CHANNELS * lostTracks.length),
      observedRows = this.completeRows.filter((row) => !leftOut[row]),
      birth = mostFrequent(observedRows.map((row) => birthGroups[arrivalIndices[row]])),
      peers = observedRows.filter((row) => birthGroups[arrivalIndices[row]] === birth),
      enough = peers.length >= NEIGHBOURS,
      caseOf = (arrivalIndex: number) =>
        enough && birthGroups[arrivalIndex] === birth ? "peers" : trackProperties.isNew(arrivalIndex) ? "new" : "old";
    lostTracks.forEach((arrivalIndex, n) => {
      if (!observedRows.length || caseOf(arrivalIndex) !== "peers")
        repeatLastOffset(trackProperties.lastOffsets, arrivalIndex, out, n * frames, frames);
    });
    for (const kind of ["peers", "new", "old"]) {
      const sources = kind === "peers" ? peers : observedRows,
        at = Int32Array.from(lostTracks.keys()).filter((n) => caseOf(lostTracks[n]) === kind);
      if (!at.length || !sources.length) continue;
      const field = this.#field(kind, sources, birth, leftOut);
      for (const n of at) {
        const own = out.subarray(n * frames * NUM_CHANNELS, (n + 1) * frames * NUM_CHANNELS);
        if (kind === "peers") field.predict(lostTracks[n], own);
        else field.addChanges(lostTracks[n], own);
      }
    }
    if (observedRows.length) fadeIn(received, lostTracks, trackProperties, frames, out);
    return out;
  }

  /**
   * Returns the motion field of the rows `sources`. One field with all rows is kept. It leaves out rows with 1 in
   * `leftOut`.
   */
  #field(kind: string, sources: Int32Array, birth: number, leftOut: Uint8Array): MotionField {
    const { received, trackProperties, frames } = this,
      make = (rows: Int32Array) => {
        const references = referenceOffsetsOf(kind, received, rows, trackProperties, frames);
        return new MotionField(received, rows, references, trackProperties, frames);
      };
    if (sources.length < NEIGHBOURS) return make(sources);
    const name = `${kind} ${birth}`,
      all = this.completeRows.filter(
        (row) => kind !== "peers" || this.birthGroups[received.arrivalIndices[row]] === birth,
      ),
      field = this.#fields.get(name) ?? make(all);
    this.#fields.set(name, field);
    field.leaveOut(leftOut);
    return field;
  }
}

/** Returns the most frequent value; among equally frequent ones the smallest. */
function mostFrequent(values: Int32Array): number {
  const counts: number[] = [];
  for (const value of values) counts[value] = (counts[value] ?? 0) + 1;
  return counts.reduce((best, count, value) => (count > (counts[best] ?? 0) ? value : best), 0);
}

/** Repeats a track's last offset in all frames, written from row `toRow` of `out`, shape (rows, channels). */
export function repeatLastOffset(
  lastOffsets: Float32Array,
  arrivalIndex: number,
  out: Float32Array,
  toRow: number,
  frames: number,
): void {
  for (let k = toRow * NUM_CHANNELS; k < (toRow + frames) * NUM_CHANNELS; k++)
    out[k] = lastOffsets[arrivalIndex * NUM_CHANNELS + (k % NUM_CHANNELS)];
}

/**
 * Returns the reference offsets of the neighbours' motion, by case: null for tracks born together (`peers`), the first
 * frame of this group for new tracks (`new`), the end of the group before otherwise.
 */
function referenceOffsetsOf(
  kind: string,
  received: TrackOffsets,
  observedRows: Int32Array,
  trackProperties: TrackProperties,
  frames: number,
): Float32Array | null {
  if (kind === "peers") return null;
  const found = new Float32Array(observedRows.length * NUM_CHANNELS);
  observedRows.forEach((row, n) => {
    const [values, at] =
      kind === "new" ? [received.offsets, row * frames] : [trackProperties.lastOffsets, received.arrivalIndices[row]];
    found.set(values.subarray(at * NUM_CHANNELS, (at + 1) * NUM_CHANNELS), n * NUM_CHANNELS);
  });
  return found;
}

/**
 * Fades in tracks with an unknown first frame. Their opacity is multiplied by the share of similar tracks that exist in
 * each frame.
 */
function fadeIn(
  received: TrackOffsets,
  lostTracks: Int32Array,
  { hasUnknownBirth }: TrackProperties,
  frames: number,
  out: Float32Array,
): void {
  const begins = received.begins.filter((_, n) => hasUnknownBirth(received.arrivalIndices[n]));
  if (!begins.length) return;
  const some = Int32Array.from(lostTracks.keys()).filter((n) => hasUnknownBirth(lostTracks[n]));
  for (let frame = 0; frame < frames; frame++) {
    const share = begins.reduce((sum, begin) => sum + Number(begin <= frame), 0) / begins.length;
    if (share === 1) return; // the share is 1 in all later frames
    for (const n of some) out[(n * frames + frame) * NUM_CHANNELS + OPACITY] += Math.log(Math.max(share, MIN_FADE));
  }
}
