// What a window shows of a scene from a place.

import { type Quat, Vec3 } from "playcanvas";

import type { Camera } from "../model/camera.ts";

/** Field of view, degrees: down, unless that is too narrow across. */
const DOWN = 50,
  ACROSS = 40,
  MOST_DOWN = 90;

/** Half of what a window shows at distance 1, downwards. */
export function tangentOf(width: number, height: number): number {
  const half = (degrees: number): number => Math.tan((degrees * Math.PI) / 360);
  return Math.min(Math.max(half(DOWN), (half(ACROSS) * height) / Math.max(width, 1)), half(MOST_DOWN));
}

export interface Pose {
  readonly position: Vec3;
  readonly rotation: Quat;
}

/**
 * Share of the picture's side around it in which Gaussians of a view are asked for, too: the camera may turn before
 * others are there.
 */
const MARGIN = 0.25;

/** The camera of a pose that is in units of `size`, for a picture of this size. */
export function cameraOf({ position, rotation }: Pose, size: number, width: number, height: number): Camera {
  const row = (x: number, y: number, z: number): number[] => {
    const axis = rotation.transformVector(new Vec3(x, y, z), new Vec3());
    return [axis.x, axis.y, axis.z, -(axis.x * position.x + axis.y * position.y + axis.z * position.z) * size];
  };
  const focal = height / 2 / tangentOf(width, height);
  return {
    viewmat: [row(1, 0, 0), row(0, -1, 0), row(0, 0, -1)],
    focal,
    width,
    height,
    margin: MARGIN * Math.max(width, height),
  };
}
