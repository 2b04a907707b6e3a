// Bases of tracks that arrived, one after another in arrays that grow: memory follows what came, not what is announced.

import { BitstreamError } from "../../bytes.ts";
import { COLUMNS, LATTICE } from "../gaussians/layout.ts";
import { emptySplats, type Splats } from "../splats.ts";
import { NUM_CHANNELS } from "./layout.ts";
import type { ClipInfo } from "./side_info.ts";
import { MotionSteps } from "./steps.ts";

/** Four bytes each are kept of all tracks that a manifest announces. */
const MAX_TRACKS = 1 << 24;
const FIRST_ROOM = 1024;
/** Memory that a track takes beside its Gaussian. */
export const TRACK_BYTES = 4 + 24 + 4 * NUM_CHANNELS;

export class Bases {
  /** Slot of each track; -1 where its base is not there. */
  slots: Int32Array;
  /** Track of each slot. */
  tracks = new Int32Array(FIRST_ROOM);
  /** Group of frames that each was born in. */
  born = new Int32Array(FIRST_ROOM);
  /** Places in half lattice units of the scene, 3 each. */
  places = new Float64Array(3 * FIRST_ROOM);
  /** log2 of the steps of motion, one for each channel. */
  shifts = new Int32Array(NUM_CHANNELS * FIRST_ROOM);
  splats: Splats;
  count = 0;
  readonly #steps: MotionSteps;

  constructor(public info: ClipInfo) {
    this.slots = slotsOf(info);
    this.splats = emptySplats(FIRST_ROOM, info.bases.degree);
    this.#steps = new MotionSteps(info.bases, info.coarser);
  }

  /** Goes on with a clip that has more tracks by now. */
  grow(info: ClipInfo): void {
    const slots = slotsOf(info);
    slots.set(this.slots);
    this.slots = slots;
    this.info = info;
  }

  /** Takes Gaussians that follow each other from a track on: their integers, the corner of their block, and they. */
  add(first: number, rows: Float64Array, corner: Float64Array, splats: Splats): void {
    const { count } = splats,
      group = this.info.groups.findIndex(({ firstNew, births }) => first < firstNew + births);
    this.#reserve(this.count + count);
    for (let i = 0; i < count; i++) {
      const slot = this.count++,
        row = i * COLUMNS;
      this.slots[first + i] = slot;
      this.tracks[slot] = first + i;
      this.born[slot] = group;
      for (let a = 0; a < 3; a++) this.places[3 * slot + a] = rows[row + LATTICE + a] + 2 * corner[a];
      this.#steps.of(rows, row, this.shifts, NUM_CHANNELS * slot);
    }
    const from = this.count - count;
    for (const name of ["means", "quats", "scales", "opacities", "colours", "harmonics"] as const) {
      const width = splats[name].length / Math.max(count, 1);
      this.splats[name].set(splats[name], width * from);
    }
  }

  #reserve(count: number): void {
    const room = this.tracks.length;
    if (count <= room) return;
    const larger = Math.max(count, 2 * room),
      wider = emptySplats(larger, this.splats.degree);
    for (const name of ["means", "quats", "scales", "opacities", "colours", "harmonics"] as const)
      wider[name].set(this.splats[name]);
    this.splats = wider;
    this.tracks = grown(this.tracks, new Int32Array(larger));
    this.born = grown(this.born, new Int32Array(larger));
    this.places = grown(this.places, new Float64Array(3 * larger));
    this.shifts = grown(this.shifts, new Int32Array(NUM_CHANNELS * larger));
  }
}

function grown<T extends Int32Array | Float64Array>(old: T, larger: T): T {
  larger.set(old as never);
  return larger;
}

function slotsOf({ numTracks }: ClipInfo): Int32Array {
  if (numTracks > MAX_TRACKS) throw new BitstreamError(`${numTracks} tracks are more than this page can play`);
  return new Int32Array(numTracks).fill(-1);
}
