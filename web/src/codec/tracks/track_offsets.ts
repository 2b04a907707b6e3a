// Offsets of tracks from their keyframe Gaussians, and what concealment needs to know of each track.

import type { Splats } from "../splats.ts";

/**
 * Offsets of a group's tracks from their keyframe Gaussians, shape (tracks, frames, channels). Channels and units are
 * those of `offsetsOf` (`trajectories.ts`), not those of coded coefficients (`layout.ts`).
 */
export interface TrackOffsets {
  /** Arrival index of the track of each row (see `KeyframeGaussians`). */
  readonly arrivalIndices: Int32Array;
  /** First frame and end frame of each track within the group. */
  readonly begins: Int32Array;
  readonly ends: Int32Array;
  readonly offsets: Float32Array;
}

/** Properties of the tracks that the concealment of a group needs, by arrival index. */
export interface TrackProperties {
  /** Keyframe Gaussians of all tracks, without offsets, with those born in this group. */
  readonly splats: Splats;
  /** Offset from the keyframe Gaussian in the last frame of the group before, shape (keyframes, channels). */
  readonly lastOffsets: Float32Array;
  /** Tracks whose last offset was estimated, because their motion was lost (1); null if none. */
  readonly wasConcealed: Uint8Array | null;
  /** Returns true if the track is born in this group. */
  readonly isNew: (arrivalIndex: number) => boolean;
  /** Returns true if the track is born in this group and its first frame is unknown. */
  readonly hasUnknownBirth: (arrivalIndex: number) => boolean;
  /** Returns the quantisation step of a track's position, world units. */
  readonly positionStep: (arrivalIndex: number) => number;
}
