// The main part of a scene, without faint Gaussians and distant outliers.

export interface SceneCore {
  /** A few thousand Gaussians, shape (samples, 4): x, y, z and radius. */
  readonly samples: Float32Array;
  readonly middle: readonly number[];
  /** Distance from the centre that contains half of the samples, and the radius of the scene. */
  readonly medianRadius: number;
  readonly radius: number;
}
