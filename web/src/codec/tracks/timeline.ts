// Timing of a clip.

/** Frame rate and length of a clip. */
export interface Timeline {
  /** Frames per second. */
  readonly rate: number;
  readonly numFrames: number;
  /** Frames per group; the last group may have fewer. */
  readonly groupFrames: number;
}

/** Tracks born in a group, and tracks of its motion packets; `numMotionTracks` is 0 if the group has no motion. */
export interface GroupCounts {
  readonly numBirths: number;
  readonly numMotionTracks: number;
  /** First track born in the group. */
  readonly firstNew: number;
}
