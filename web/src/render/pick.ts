// Picking: the point of the scene at a pixel.

import type { Camera } from "../model/camera.ts";
import { HALF_FLOAT_VALUES, type Packed } from "./packed.ts";

const OPAQUE = 1 / 255,
  BLUR = 0.3,
  NEAR_PLANE = 0.01;
/** Squared radii at which an opaque Gaussian fades to 1/255. */
const MAX_SQUARED_RADII = 2 * Math.log(1 / OPAQUE);
/** Upper approximation of its square root. */
const RADII = 4;
/** Least absorbed share of light that counts as a hit. */
const MIN_HIT_SHARE = 0.2;
/** Distance at which opacity counts as much as proximity, relative to the picture's height. */
const NEARBY = 1 / 8;

type Point = [number, number, number];

/** Bounding sphere of each part: x, y, z, radius. */
const boundingSpheres = new WeakMap<Packed, readonly number[]>();

/**
 * Returns the point at the median depth of a pixel's light. Without a hit returns the centre of a nearby Gaussian, or
 * null in an empty picture. Lengths are in the units of `parts`.
 */
export function pickPoint(parts: readonly Packed[], camera: Camera, px: number, py: number): Point | null {
  const depth = pickDepth(parts, camera, px, py);
  return depth === null ? nearestCentre(parts, camera, px, py) : pointOnRay(camera, px, py, depth);
}

/** Returns the median depth of a pixel's light; null without a hit. */
export function pickDepth(parts: readonly Packed[], camera: Camera, px: number, py: number): number | null {
  const met: [number, number][] = [];
  const some = parts.filter((part) => rayIntersects(part, camera, px, py));
  project(some, camera, ({ scales, opacities }, i, u, v, depth) => {
    const away = (u - px) ** 2 + (v - py) ** 2,
      scale = (camera.focal / depth) ** 2,
      a = scales[4 * i],
      b = scales[4 * i + 1],
      c = scales[4 * i + 2],
      largest = Math.max(a, b, c), // the bits of positive half floats sort like their values
      most = HALF_FLOAT_VALUES[largest];
    if (away > MAX_SQUARED_RADII * (scale * most * most + BLUR)) return;
    const middle = HALF_FLOAT_VALUES[a + b + c - largest - Math.min(a, b, c)],
      alpha = opacities[i] * Math.exp((-0.5 * away) / (scale * middle * most + BLUR));
    if (alpha >= OPAQUE) met.push([depth, alpha]);
  });
  met.sort(([one], [other]) => one - other);
  const passed = met.reduce((left, [, alpha]) => left * (1 - alpha), 1),
    half = 1 - (1 - passed) / 2;
  if (1 - passed < MIN_HIT_SHARE) return null;
  let left = 1;
  for (const [depth, alpha] of met) if ((left *= 1 - alpha) <= half) return depth;
  return null;
}

/** Returns true if a pixel's ray can hit a part, including the blur of less than a pixel. */
function rayIntersects(part: Packed, { viewmat, focal, width, height }: Camera, px: number, py: number): boolean {
  const [x, y, z, radius] = boundingSpheres.get(part) ?? boundingSphere(part),
    [u, v, depth] = viewmat.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]),
    across = (px - width / 2) / focal,
    down = (py - height / 2) / focal,
    reach = radius * (1 + Math.hypot(across, down)) + (RADII * (depth + radius)) / focal;
  return Math.hypot(u - across * depth, v - down * depth) <= reach;
}

function boundingSphere(part: Packed): readonly number[] {
  const { centers, scales, count } = part,
    middle = 4 * (count >> 1),
    [x, y, z] = centers.subarray(middle, middle + 3);
  let radius = 0;
  for (let n = 0; n < 4 * count; n += 4) {
    const size = HALF_FLOAT_VALUES[Math.max(scales[n], scales[n + 1], scales[n + 2])];
    radius = Math.max(radius, Math.hypot(centers[n] - x, centers[n + 1] - y, centers[n + 2] - z) + RADII * size);
  }
  const ball = [x, y, z, radius];
  boundingSpheres.set(part, ball);
  return ball;
}

/** Returns the centre of the visible Gaussian nearest to a pixel, weighted by opacity. */
function nearestCentre(parts: readonly Packed[], camera: Camera, px: number, py: number): Point | null {
  const { width, height } = camera,
    blur = (NEARBY * height) ** 2;
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

/** Projects the centres in front of a camera and calls `take` with their pixel position and depth. */
function project(
  parts: readonly Packed[],
  { viewmat, focal, width, height }: Camera,
  take: (part: Packed, i: number, u: number, v: number, depth: number) => void,
): void {
  const [[xx, xy, xz, xt], [yx, yy, yz, yt], [zx, zy, zz, zt]] = viewmat;
  for (const part of parts) {
    const { centers, count } = part;
    for (let i = 0; i < count; i++) {
      const a = centers[4 * i],
        b = centers[4 * i + 1],
        c = centers[4 * i + 2],
        depth = zx * a + zy * b + zz * c + zt;
      if (depth <= NEAR_PLANE) continue;
      const scale = focal / depth,
        u = width / 2 + scale * (xx * a + xy * b + xz * c + xt);
      take(part, i, u, height / 2 + scale * (yx * a + yy * b + yz * c + yt), depth);
    }
  }
}

/** Returns the point of a pixel's ray at a depth. */
function pointOnRay({ viewmat, focal, width, height }: Camera, px: number, py: number, depth: number): Point {
  const seen = [((px - width / 2) * depth) / focal, ((py - height / 2) * depth) / focal, depth],
    away = viewmat.map((row, a) => seen[a] - row[3]);
  return [0, 1, 2].map((axis) => viewmat.reduce((sum, row, a) => sum + row[axis] * away[a], 0)) as Point;
}
