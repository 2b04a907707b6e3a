// Offsets of tracks from their bases.

import type { Splats } from "../splats.ts";

/** Offsets of a group's tracks from their bases, shape (tracks, frames, channels). */
export interface TrackOffsets {
  /** Slot of each track. */
  readonly slots: Int32Array;
  /** First frame and end frame of each track within the group. */
  readonly begins: Int32Array;
  readonly ends: Int32Array;
  readonly offsets: Float32Array;
}

/** State of the tracks before a group, by slot. */
export interface PreviousState {
  readonly splats: Splats;
  /** Offset from the base in the last frame, shape (slots, channels). */
  readonly lastOffsets: Float32Array;
  /** Tracks with an estimated last offset (1); null if none. */
  readonly wasExtrapolated: Uint8Array | null;
  /** Returns true if the track is born in this group. */
  readonly isNew: (slot: number) => boolean;
  /** Returns true if the track is born in this group and its first frame is unknown. */
  readonly hasUnknownBirth: (slot: number) => boolean;
  /** Returns the quantisation step of a track's position, world units. */
  readonly positionStep: (slot: number) => number;
}
