// Cameras.

export interface Camera {
  /** World-to-camera matrix, three or four rows of four. Axes: x right, y down, z forward (OpenCV). */
  readonly viewmat: readonly (readonly number[])[];
  /** Focal length, pixels. */
  readonly focal: number;
  readonly width: number;
  readonly height: number;
  /** Width of the border around the picture that also gets Gaussians, pixels. */
  readonly margin: number;
}

/** Camera for Gaussians that do not depend on the view. */
export const ANY_CAMERA: Camera = { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };

/** Returns the camera's position, world units. */
export function cameraPosition({ viewmat: [x, y, z] }: Pick<Camera, "viewmat">): [number, number, number] {
  const along = (a: number): number => -(x[a] * x[3] + y[a] * y[3] + z[a] * z[3]);
  return [along(0), along(1), along(2)];
}

/**
 * Camera as `splatwire` writes it: a world-to-camera matrix with OpenCV axes. The focal length is in pixels of a
 * picture of this height.
 */
export interface FixedCamera {
  readonly viewmat: readonly (readonly number[])[];
  readonly focal: number;
  readonly height: number;
  /** Picture width, pixels. The default follows the element's aspect ratio. */
  readonly width?: number;
}

/**
 * Throws `TypeError` for a camera whose matrix is no list of rows, such as the 16 numbers of three.js, or without the
 * other numbers. `defaultWidth` is the width of a camera without one.
 */
export function checkCamera(
  camera: FixedCamera & { readonly margin?: number | undefined },
  defaultWidth?: number,
): void {
  const { viewmat, focal, height, width = defaultWidth, margin = 0 } = camera ?? {},
    rows = Array.from((viewmat as unknown as ArrayLike<ArrayLike<number>> | undefined) ?? []);
  if (
    ![3, 4].includes(rows.length) ||
    !rows.every((row) => row?.length === 4 && Array.from(row).every(Number.isFinite))
  )
    throw new TypeError(
      "the `viewmat` of a camera is three or four rows of four numbers, from the world to the camera",
    );
  if (![focal, height, width].every((size) => Number.isFinite(size) && size! > 0) || !(margin >= 0))
    throw new TypeError(
      "`focal`, `width` and `height` of a camera are positive numbers of pixels, and `margin` is not negative",
    );
}
