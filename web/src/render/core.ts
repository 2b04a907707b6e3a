// What a scene is, without what is faint or far away from all else.

export interface Core {
  /** Some thousand Gaussians of a scene: x, y, z and a radius of each. */
  readonly samples: Float32Array;
  readonly middle: readonly number[];
  /** Distance from the middle within which half of them lie, and where the scene ends. */
  readonly half: number;
  readonly radius: number;
}
