// What somebody points at.

import type { Camera } from "../model/camera.ts";
import { FLOATS, type Packed } from "./packed.ts";

const OPAQUE = 1 / 255,
  BLUR = 0.3,
  NEAREST = 0.01;
/** Radii squared beyond which a Gaussian stops no light. */
const END = 2 * Math.log(1 / OPAQUE);
/** So much of the light has to stop before something is there. */
const SOMETHING = 0.2;
/** How far apart two things are of which the more opaque one is pointed at, over the picture's height. */
const REACH = 1 / 8;

type Point = [number, number, number];

/**
 * Where half of the light of a pixel comes from; where next to nothing is there, the middle of the Gaussian next to it;
 * null where the picture is empty. Lengths of the camera and of the point are those of `parts`.
 */
export function pointAt(parts: readonly Packed[], camera: Camera, px: number, py: number): Point | null {
  const depth = depthAt(parts, camera, px, py);
  return depth === null ? nextTo(parts, camera, px, py) : onRay(camera, px, py, depth);
}

/** Depth at which half of the light of a pixel has come, null where next to nothing is there. */
export function depthAt(parts: readonly Packed[], camera: Camera, px: number, py: number): number | null {
  const met: [number, number][] = [];
  project(parts, camera, ({ scales, opacities }, i, u, v, depth) => {
    const [a, b, c] = [FLOATS[scales[4 * i]], FLOATS[scales[4 * i + 1]], FLOATS[scales[4 * i + 2]]],
      scale = (camera.focal / depth) ** 2,
      away = (u - px) ** 2 + (v - py) ** 2,
      most = Math.max(a, b, c);
    if (away > END * (scale * most * most + BLUR)) return;
    const middle = a + b + c - most - Math.min(a, b, c),
      alpha = opacities[i] * Math.exp((-0.5 * away) / (scale * middle * most + BLUR));
    if (alpha >= OPAQUE) met.push([depth, alpha]);
  });
  met.sort(([one], [other]) => one - other);
  const passed = met.reduce((left, [, alpha]) => left * (1 - alpha), 1),
    half = 1 - (1 - passed) / 2;
  if (1 - passed < SOMETHING) return null;
  let left = 1;
  for (const [depth, alpha] of met) if ((left *= 1 - alpha) <= half) return depth;
  return null;
}

/** The middle of the Gaussian of a picture that is nearest to a pixel, or more opaque and not much farther. */
function nextTo(parts: readonly Packed[], camera: Camera, px: number, py: number): Point | null {
  const { width, height } = camera,
    blur = (REACH * height) ** 2;
  let best = 0,
    found: Point | null = null;
  project(parts, camera, ({ centers, opacities }, i, u, v) => {
    if (u < 0 || v < 0 || u > width || v > height) return;
    const near = opacities[i] / (1 + ((u - px) ** 2 + (v - py) ** 2) / blur);
    if (near <= best) return;
    best = near;
    found = [centers[4 * i], centers[4 * i + 1], centers[4 * i + 2]];
  });
  return found;
}

/** Tells where the middles of the Gaussians before a camera are in its picture, and how deep. */
function project(
  parts: readonly Packed[],
  { viewmat: [x, y, z], focal, width, height }: Camera,
  take: (part: Packed, i: number, u: number, v: number, depth: number) => void,
): void {
  for (const part of parts) {
    for (let i = 0; i < part.count; i++) {
      const [a, b, c] = [part.centers[4 * i], part.centers[4 * i + 1], part.centers[4 * i + 2]],
        depth = z[0] * a + z[1] * b + z[2] * c + z[3];
      if (depth <= NEAREST) continue;
      const scale = focal / depth,
        u = width / 2 + scale * (x[0] * a + x[1] * b + x[2] * c + x[3]);
      take(part, i, u, height / 2 + scale * (y[0] * a + y[1] * b + y[2] * c + y[3]), depth);
    }
  }
}

/** Where a pixel's ray is at a depth. */
function onRay({ viewmat, focal, width, height }: Camera, px: number, py: number, depth: number): Point {
  const seen = [((px - width / 2) * depth) / focal, ((py - height / 2) * depth) / focal, depth],
    away = viewmat.map((row, a) => seen[a] - row[3]);
  return [0, 1, 2].map((axis) => viewmat.reduce((sum, row, a) => sum + row[axis] * away[a], 0)) as Point;
}
