// Camera projection of a window.

import { type Quat, Vec3 } from "playcanvas";

import type { Camera } from "../model/camera.ts";

/** Vertical field of view, least horizontal one, and largest vertical one, degrees. */
const VERTICAL_FOV = 50,
  MIN_HORIZONTAL_FOV = 40,
  MAX_VERTICAL_FOV = 90;

/** Distance beyond which nothing is drawn, in units of the scene's size. */
export const FAR_CLIP = 2000;

/** Returns half the height of the window at distance 1. */
export function halfHeight(width: number, height: number): number {
  const half = (degrees: number): number => Math.tan((degrees * Math.PI) / 360);
  return Math.min(
    Math.max(half(VERTICAL_FOV), (half(MIN_HORIZONTAL_FOV) * height) / Math.max(width, 1)),
    half(MAX_VERTICAL_FOV),
  );
}

export interface Pose {
  readonly position: Vec3;
  readonly rotation: Quat;
}

/**
 * Border around the picture that also gets Gaussians, relative to its larger side. It covers rotations until the next
 * update.
 */
const MARGIN = 0.25;

/** Returns the camera of a pose, given in units of `size`, for a picture of this size. */
export function cameraFromPose({ position, rotation }: Pose, size: number, width: number, height: number): Camera {
  const row = (x: number, y: number, z: number): number[] => {
    const axis = rotation.transformVector(new Vec3(x, y, z), new Vec3());
    return [axis.x, axis.y, axis.z, -(axis.x * position.x + axis.y * position.y + axis.z * position.z) * size];
  };
  const focal = height / 2 / halfHeight(width, height);
  return {
    viewmat: [row(1, 0, 0), row(0, -1, 0), row(0, 0, -1)],
    focal,
    width,
    height,
    margin: MARGIN * Math.max(width, height),
  };
}
