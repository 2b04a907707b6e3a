// Received keyframe Gaussians of tracks, in growing arrays. Memory is proportional to the received tracks, not to the
// announced ones.

import { BitstreamError } from "../../bytes.ts";
import { COLUMNS, POSITION } from "../gaussians/layout.ts";
import { emptySplats, type Splats } from "../splats.ts";
import { HEADER_FIELDS, MAX_COORD, NUM_CHANNELS, TRACK } from "./layout.ts";
import type { TrackKeyframes } from "./motion_packets.ts";
import { type SequenceInfo, type Shot, shotOf } from "./side_info.ts";
import { limitShift, MotionSteps } from "./steps.ts";

/** Largest number of tracks. Each announced track takes four bytes. */
const MAX_TRACKS = 1 << 24;
const MIN_CAPACITY = 1024;
/** Memory of a track in addition to its Gaussian, bytes: `tracks`, `birthGroups`, `positions` and `shifts`. */
export const TRACK_BYTES = 4 + 4 + 3 * 8 + 4 * NUM_CHANNELS;

export class KeyframeGaussians {
  /** Arrival index by track number: index of the track's keyframe Gaussian in order of arrival; -1 if not received. */
  arrivalIndexOfTrack: Int32Array;
  /** Track of each keyframe Gaussian, by arrival index. */
  tracks = new Int32Array(MIN_CAPACITY);
  /** Birth group of each track, by arrival index. */
  birthGroups = new Int32Array(MIN_CAPACITY);
  /** Positions in the units of motion of the birth groups, shape (keyframes, 3). */
  positions = new Float64Array(3 * MIN_CAPACITY);
  /** log2 of the motion steps, shape (keyframes, channels). */
  shifts = new Int32Array(NUM_CHANNELS * MIN_CAPACITY);
  splats: Splats;
  count = 0;
  #steps: MotionSteps;

  constructor(public info: SequenceInfo) {
    this.arrivalIndexOfTrack = noIndices(info);
    this.splats = emptySplats(MIN_CAPACITY, info.keyframeInfo.degree);
    this.#steps = stepsOf(info, info.shots[0]);
  }

  /** Continues with a longer clip, which has more tracks. */
  grow(info: SequenceInfo): void {
    const arrivalIndexOfTrack = noIndices(info);
    arrivalIndexOfTrack.set(this.arrivalIndexOfTrack);
    this.arrivalIndexOfTrack = arrivalIndexOfTrack;
    this.info = info;
  }

  /**
   * Adds the Gaussians of consecutive tracks, beginning with track `first`. `rows` are their integers, `block` is their
   * block among all blocks of keyframe Gaussians.
   */
  add(first: number, rows: Float64Array, block: number, splats: Splats): void {
    const { count } = splats,
      shot = shotOf(this.info, block),
      { corners } = shot.keyframeInfo.boxes,
      corner = 3 * (block - shot.firstBlock),
      scale = 2 ** shot.latticeShift,
      group = this.info.groups.findIndex(({ firstNew, numBirths }) => first < firstNew + numBirths);
    this.#reserve(this.count + count);
    if (this.#steps.info !== shot.keyframeInfo) this.#steps = stepsOf(this.info, shot);
    for (let i = 0; i < count; i++) {
      const arrivalIndex = this.count++,
        row = i * COLUMNS;
      this.arrivalIndexOfTrack[first + i] = arrivalIndex;
      this.tracks[arrivalIndex] = first + i;
      this.birthGroups[arrivalIndex] = group;
      for (let a = 0; a < 3; a++) {
        this.positions[3 * arrivalIndex + a] = scaledCoord(rows[row + POSITION + a] + 2 * corners[corner + a], scale);
      }
      this.#steps.of(rows, row, this.shifts, NUM_CHANNELS * arrivalIndex);
    }
    const from = this.count - count;
    for (const name of ["means", "quats", "scales", "opacities", "colours", "harmonics"] as const) {
      const width = splats[name].length / Math.max(count, 1);
      this.splats[name].set(splats[name], width * from);
    }
  }

  /**
   * Returns the positions and steps of the tracks of a packet with these headers, for the unit of motion of a group;
   * null if one was not received.
   */
  of(headers: Int32Array, group: number): TrackKeyframes | null {
    const count = headers.length / HEADER_FIELDS,
      unit = this.info.log2MotionUnits[group],
      positions = new Float64Array(3 * count),
      shifts = new Int32Array(NUM_CHANNELS * count);
    for (let i = 0; i < count; i++) {
      const arrivalIndex = this.arrivalIndexOfTrack[headers[HEADER_FIELDS * i + TRACK]] ?? -1;
      if (arrivalIndex < 0) return null;
      for (let c = 0; c < NUM_CHANNELS; c++)
        shifts[NUM_CHANNELS * i + c] = this.shifts[NUM_CHANNELS * arrivalIndex + c];
      const octaves = this.info.log2MotionUnits[this.birthGroups[arrivalIndex]] - unit;
      for (let a = 0; a < 3; a++) {
        positions[3 * i + a] = scaledCoord(this.positions[3 * arrivalIndex + a], 2 ** octaves);
        shifts[NUM_CHANNELS * i + a] = limitShift(shifts[NUM_CHANNELS * i + a] + octaves);
      }
    }
    return { positions, shifts };
  }

  #reserve(count: number): void {
    const capacity = this.tracks.length;
    if (count <= capacity) return;
    const larger = Math.max(count, 2 * capacity),
      wider = emptySplats(larger, this.splats.degree);
    for (const name of ["means", "quats", "scales", "opacities", "colours", "harmonics"] as const)
      wider[name].set(this.splats[name]);
    this.splats = wider;
    this.tracks = copyInto(this.tracks, new Int32Array(larger));
    this.birthGroups = copyInto(this.birthGroups, new Int32Array(larger));
    this.positions = copyInto(this.positions, new Float64Array(3 * larger));
    this.shifts = copyInto(this.shifts, new Int32Array(NUM_CHANNELS * larger));
  }
}

function scaledCoord(coord: number, scale: number): number {
  return Math.min(Math.max(Math.floor(coord * scale), -MAX_COORD), MAX_COORD);
}

function stepsOf({ logStepRatios }: SequenceInfo, { keyframeInfo, latticeShift }: Shot): MotionSteps {
  return new MotionSteps(keyframeInfo, logStepRatios, latticeShift);
}

function copyInto<T extends Int32Array | Float64Array>(old: T, larger: T): T {
  larger.set(old as never);
  return larger;
}

function noIndices({ numTracks }: SequenceInfo): Int32Array {
  if (numTracks > MAX_TRACKS) throw new BitstreamError(`${numTracks} tracks exceed the limit of ${MAX_TRACKS}`);
  return new Int32Array(numTracks).fill(-1);
}
