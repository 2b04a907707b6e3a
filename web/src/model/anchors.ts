// Anchors as inputs of the neural heads.

import type { Camera } from "./camera.ts";

export interface Anchors {
  readonly count: number;
  readonly numOffsets: number;
  /** Positions x, y, z, shape (count, 3), world units. */
  readonly positions: Float32Array;
  /** Length of one unit of `offsets`, shape (count), world units. */
  readonly scales: Float32Array;
  /** Upper bounds of the Gaussians' standard deviations along their axes, shape (count, 3), world units. */
  readonly sizes: Float32Array;
  /**
   * Existing offsets (1) per anchor, shape (count, numOffsets), and the offsets in units of `scales`, shape (count,
   * numOffsets, 3).
   */
  readonly masks: Uint8Array;
  readonly offsets: Float32Array;
}

const NEAR_DEPTH = 0.2,
  DILATION = 0.3,
  FRUSTUM_MARGIN = 0.3,
  TILE = 16;

/**
 * Returns true if the camera may see an anchor: projected as a Gaussian of size `scale`, it overlaps a tile of the
 * picture. Same test as in `splatwire.anchors`.
 */
export function inView(
  { viewmat: [right, down, ahead], focal, width, height, margin }: Camera,
  x: number,
  y: number,
  z: number,
  scale: number,
): boolean {
  const depth = ahead[0] * x + ahead[1] * y + ahead[2] * z + ahead[3];
  if (!(depth > NEAR_DEPTH)) return false;
  const u = (right[0] * x + right[1] * y + right[2] * z + right[3]) / depth,
    v = (down[0] * x + down[1] * y + down[2] * z + down[3]) / depth;
  const limitX = ((1 + FRUSTUM_MARGIN) * width) / (2 * focal),
    limitY = ((1 + FRUSTUM_MARGIN) * height) / (2 * focal);
  const s = Math.min(Math.max(u, -limitX), limitX),
    t = Math.min(Math.max(v, -limitY), limitY),
    size = (focal / depth) * scale;
  let xx = DILATION,
    xy = 0,
    yy = DILATION;
  for (let k = 0; k < 3; k++) {
    const a = size * (right[k] - s * ahead[k]),
      b = size * (down[k] - t * ahead[k]);
    xx += a * a;
    xy += a * b;
    yy += b * b;
  }
  const middle = (xx + yy) / 2,
    reach = middle + Math.sqrt(Math.max(middle * middle - (xx * yy - xy * xy), 0.1));
  const radius = Math.ceil(3 * Math.sqrt(reach)) + margin,
    px = focal * u + width / 2 - 0.5,
    py = focal * v + height / 2 - 0.5;
  return (
    px + radius >= 1 &&
    px - radius < Math.ceil(width / TILE) * TILE &&
    py + radius >= 1 &&
    py - radius < Math.ceil(height / TILE) * TILE
  );
}
