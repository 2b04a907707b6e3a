// What somebody points at.

import type { Camera } from "../model/camera.ts";
import { FLOATS, type Packed } from "./packed.ts";

const OPAQUE = 1 / 255,
  BLUR = 0.3,
  NEAREST = 0.01;
/** Radii squared beyond which a Gaussian stops no light. */
const END = 2 * Math.log(1 / OPAQUE);
/** About where that is, and not nearer. */
const RADII = 4;
/** So much of the light has to stop before something is there. */
const SOMETHING = 0.2;
/** How far apart two things are of which the more opaque one is pointed at, over the picture's height. */
const REACH = 1 / 8;

type Point = [number, number, number];

/** A ball around a part: x, y, z, radius. */
const balls = new WeakMap<Packed, readonly number[]>();

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
  const some = parts.filter((part) => meets(part, camera, px, py));
  project(some, camera, ({ scales, opacities }, i, u, v, depth) => {
    const away = (u - px) ** 2 + (v - py) ** 2,
      scale = (camera.focal / depth) ** 2,
      a = scales[4 * i],
      b = scales[4 * i + 1],
      c = scales[4 * i + 2],
      largest = Math.max(a, b, c), // bits of halves are in their order
      most = FLOATS[largest];
    if (away > END * (scale * most * most + BLUR)) return;
    const middle = FLOATS[a + b + c - largest - Math.min(a, b, c)],
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

/** Whether a pixel's ray can meet one of a part; less than a pixel wider, by which each is blurred. */
function meets(part: Packed, { viewmat, focal, width, height }: Camera, px: number, py: number): boolean {
  const [x, y, z, radius] = balls.get(part) ?? ballOf(part),
    [u, v, depth] = viewmat.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]),
    across = (px - width / 2) / focal,
    down = (py - height / 2) / focal,
    reach = radius * (1 + Math.hypot(across, down)) + (RADII * (depth + radius)) / focal;
  return Math.hypot(u - across * depth, v - down * depth) <= reach;
}

function ballOf(part: Packed): readonly number[] {
  const { centers, scales, count } = part,
    middle = 4 * (count >> 1),
    [x, y, z] = centers.subarray(middle, middle + 3);
  let radius = 0;
  for (let n = 0; n < 4 * count; n += 4) {
    const size = FLOATS[Math.max(scales[n], scales[n + 1], scales[n + 2])];
    radius = Math.max(radius, Math.hypot(centers[n] - x, centers[n + 1] - y, centers[n + 2] - z) + RADII * size);
  }
  const ball = [x, y, z, radius];
  balls.set(part, ball);
  return ball;
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
      if (depth <= NEAREST) continue;
      const scale = focal / depth,
        u = width / 2 + scale * (xx * a + xy * b + xz * c + xt);
      take(part, i, u, height / 2 + scale * (yx * a + yy * b + yz * c + yt), depth);
    }
  }
}

/** Where a pixel's ray is at a depth. */
function onRay({ viewmat, focal, width, height }: Camera, px: number, py: number, depth: number): Point {
  const seen = [((px - width / 2) * depth) / focal, ((py - height / 2) * depth) / focal, depth],
    away = viewmat.map((row, a) => seen[a] - row[3]);
  return [0, 1, 2].map((axis) => viewmat.reduce((sum, row, a) => sum + row[axis] * away[a], 0)) as Point;
}
