// Timing of a clip.

/** Frame rate and length of a clip. */
export interface Timeline {
  /** Frames per second. */
  readonly rate: number;
  readonly numFrames: number;
  /** Frames per group; the last group may have fewer. */
  readonly groupFrames: number;
}

/** Tracks born in a group, and tracks with motion in it; `numMotionTracks` is 0 if no track moves. */
export interface GroupCounts {
  readonly numBirths: number;
  readonly numMotionTracks: number;
  /** First track born in the group. */
  readonly firstNew: number;
}
