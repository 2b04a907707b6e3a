// When what is in a clip.

/** When the frames of a clip are. */
export interface Timeline {
  /** Frames a second. */
  readonly rate: number;
  readonly numFrames: number;
  /** Frames of a group; the last one may have fewer. */
  readonly groupFrames: number;
}

/** Tracks that are born in a group of frames, and those that are there in it: 0 if all stay as they were. */
export interface Group {
  readonly births: number;
  readonly motions: number;
  /** First track that is born in it. */
  readonly firstNew: number;
}
