// What is known of what tracks do.

import type { Splats } from "../splats.ts";

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
