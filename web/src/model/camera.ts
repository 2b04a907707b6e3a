// A camera: where Gaussians of a view are seen from.

export interface Camera {
  /** World to camera, three or four rows of four; x to the right, y down, z ahead. */
  readonly viewmat: readonly (readonly number[])[];
  /** Focal length, pixels. */
  readonly focal: number;
  readonly width: number;
  readonly height: number;
  /** Pixels around the picture in which Gaussians are wanted, too. */
  readonly margin: number;
}

/** Where it stands. */
export function eyeOf({ viewmat: [x, y, z] }: Pick<Camera, "viewmat">): [number, number, number] {
  const along = (a: number): number => -(x[a] * x[3] + y[a] * y[3] + z[a] * z[3]);
  return [along(0), along(1), along(2)];
}

/**
 * A camera as `splatwire` writes it: world to camera, OpenCV axes; focal length in pixels of a picture of this height.
 */
export interface FixedCamera {
  readonly viewmat: readonly (readonly number[])[];
  readonly focal: number;
  readonly height: number;
  /** That of the element's shape where absent. */
  readonly width?: number;
}
