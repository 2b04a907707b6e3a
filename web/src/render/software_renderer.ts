// Software renderer for the first pictures, on a 2D canvas, until WebGL is set up.

import { Vec3 } from "playcanvas";
import type { Pause } from "../scheduler.ts";
import { HALF_FLOAT_VALUES, type Packed } from "./packed.ts";
import { halfHeight, type Pose } from "./projection.ts";

/**
 * Largest number of pixels of a picture, and of a preview with few large Gaussians. Fewer Gaussians than the limit make
 * a preview.
 */
const MAX_PIXELS = 65_000,
  PREVIEW_PIXELS = 10_000,
  MAX_PREVIEW_COUNT = 256;
const NEAR_PLANE = 0.01,
  BLUR = 0.3,
  OPAQUE = 1 / 255,
  STEPS = 1024,
  BUCKETS = 1 << 14;
/** Number of Gaussians that are handled without a pause. */
const BATCH = 512;
/** exp(-q/2) for q from 0 to 2 ln 255, where an opaque Gaussian fades to 1/255. */
const MAX_EXPONENT = 2 * Math.log(255),
  FALLOFF = Float32Array.from({ length: STEPS + 2 }, (_, n) => Math.exp((-0.5 * n * MAX_EXPONENT) / STEPS));
/** Numbers per projected Gaussian: depth, x, y, inverse covariance (3), half height, opacity, RGB. */
const ROW = 11;

export interface PaintInput {
  readonly parts: readonly Packed[];
  readonly background: readonly number[];
  readonly pose: Pose;
  /** True if opacity decreases for Gaussians below the size of a pixel. */
  readonly antialiased?: boolean;
}

/**
 * Paints the same picture as `render/shaders.ts`, but without harmonics and at a low resolution, scaled to the canvas.
 * Calls `pause` often, so that the page stays responsive.
 */
export async function paint(canvas: HTMLCanvasElement, painted: PaintInput, pause: Pause): Promise<void> {
  const { parts } = painted,
    most = parts.length === 1 && parts[0].count < MAX_PREVIEW_COUNT ? PREVIEW_PIXELS : MAX_PIXELS;
  const shrink = Math.min(1, Math.sqrt(most / Math.max(canvas.clientWidth * canvas.clientHeight, 1)));
  const width = Math.max(Math.round(canvas.clientWidth * shrink), 1),
    height = Math.max(Math.round(canvas.clientHeight * shrink), 1);
  const steps = render(painted, width, height);
  let step = steps.next();
  for (; !step.done; step = steps.next()) await pause();
  canvas.width = width;
  canvas.height = height;
  // a GPU canvas would wait for the context that is being set up
  canvas.getContext("2d", { willReadFrequently: true })!.putImageData(new ImageData(step.value, width, height), 0, 0);
}

type Pixels = Uint8ClampedArray<ArrayBuffer>;

/** Returns the RGBA pixels of a picture. */
export function pixels(painted: PaintInput, width: number, height: number): Pixels {
  const steps = render(painted, width, height);
  for (;;) {
    const { done, value } = steps.next();
    if (done) return value;
  }
}

/** Returns the RGBA pixels of a picture. Yields after every `BATCH` Gaussians. */
function* render(
  { parts, background, pose, antialiased = false }: PaintInput,
  width: number,
  height: number,
): Generator<void, Pixels> {
  const { rows, count } = yield* project(parts, pose, antialiased, width, height),
    radiance = new Float32Array(4 * width * height);
  for (let p = 3; p < radiance.length; p += 4) radiance[p] = 1;
  const order = nearestFirst(rows, count);
  for (let i = 0; i < count; i++) {
    if (i % BATCH === 0) yield;
    splat(rows, ROW * order[i], radiance, width, height);
  }
  const out = new Uint8ClampedArray(radiance.length);
  for (let p = 0; p < out.length; p += 4) {
    for (let c = 0; c < 3; c++) out[p + c] = 255 * (radiance[p + c] + radiance[p + 3] * background[c]);
    out[p + 3] = 255;
  }
  return out;
}

/** Projects the Gaussians in front of the camera to ellipses. Yields after every `BATCH` Gaussians. */
function* project(
  parts: readonly Packed[],
  { position, rotation }: Pose,
  antialiased: boolean,
  width: number,
  height: number,
): Generator<void, { rows: Float32Array; count: number }> {
  const rows = new Float32Array(ROW * parts.reduce((sum, part) => sum + part.count, 0)),
    back = rotation.clone().invert();
  const [r, u, b] = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ].map(([x, y, z]) => back.transformVector(new Vec3(x, y, z), new Vec3()));
  const focal = height / 2 / halfHeight(width, height),
    limitX = (1.3 * width) / 2 / focal,
    limitY = (1.3 * height) / 2 / focal;
  let count = 0;
  for (const { centers, scales, rotations, opacities, colours, count: number } of parts) {
    for (let i = 0; i < number; i++) {
      if (i % BATCH === BATCH - 1) yield;
      const dx = centers[4 * i] - position.x,
        dy = centers[4 * i + 1] - position.y,
        dz = centers[4 * i + 2] - position.z;
      const x = r.x * dx + u.x * dy + b.x * dz,
        y = r.y * dx + u.y * dy + b.y * dz,
        depth = -(r.z * dx + u.z * dy + b.z * dz);
      let opacity = opacities[i];
      if (depth < NEAR_PLANE || !(opacity * 255 > 1)) continue;
      const tx = Math.min(Math.max(x / depth, -limitX), limitX),
        ty = Math.min(Math.max(y / depth, -limitY), limitY),
        scale = focal / depth;
      const qw = HALF_FLOAT_VALUES[rotations[4 * i]],
        qx = HALF_FLOAT_VALUES[rotations[4 * i + 1]],
        qy = HALF_FLOAT_VALUES[rotations[4 * i + 2]],
        qz = HALF_FLOAT_VALUES[rotations[4 * i + 3]];
      let xx = BLUR,
        xy = 0,
        yy = BLUR;
      for (let axis = 0; axis < 3; axis++) {
        const s = HALF_FLOAT_VALUES[scales[4 * i + axis]];
        const vx =
          s *
          (axis === 0 ? 1 - 2 * (qy * qy + qz * qz) : axis === 1 ? 2 * (qx * qy - qw * qz) : 2 * (qx * qz + qw * qy));
        const vy =
          s *
          (axis === 0 ? 2 * (qx * qy + qw * qz) : axis === 1 ? 1 - 2 * (qx * qx + qz * qz) : 2 * (qy * qz - qw * qx));
        const vz =
          s *
          (axis === 0 ? 2 * (qx * qz - qw * qy) : axis === 1 ? 2 * (qy * qz + qw * qx) : 1 - 2 * (qx * qx + qy * qy));
        const away = r.z * vx + u.z * vy + b.z * vz;
        const across = scale * (r.x * vx + u.x * vy + b.x * vz + tx * away),
          down = -scale * (r.y * vx + u.y * vy + b.y * vz + ty * away);
        xx += across * across;
        xy += across * down;
        yy += down * down;
      }
      if (antialiased) opacity *= Math.sqrt(Math.max((xx - BLUR) * (yy - BLUR) - xy * xy, 0) / (xx * yy - xy * xy));
      const px = width / 2 + focal * (x / depth),
        py = height / 2 - focal * (y / depth),
        reach = 2 * Math.log(opacity * 255),
        high = Math.sqrt(Math.max(reach, 0) * yy),
        wide = Math.sqrt(Math.max(reach, 0) * xx);
      if (!(reach > 0) || px + wide < 0 || px - wide > width || py + high < 0 || py - high > height) continue;
      const one = 1 / (xx * yy - xy * xy),
        at = ROW * count++;
      rows[at] = depth;
      rows[at + 1] = px;
      rows[at + 2] = py;
      rows[at + 3] = yy * one;
      rows[at + 4] = -xy * one;
      rows[at + 5] = xx * one;
      rows[at + 6] = high;
      rows[at + 7] = opacity;
      for (let c = 0; c < 3; c++) rows[at + 8 + c] = Math.max(HALF_FLOAT_VALUES[colours[4 * i + c]], 0);
    }
  }
  return { rows, count };
}

/** Returns the order by depth, sorted by buckets of its logarithm. */
function nearestFirst(rows: Float32Array, count: number): Uint32Array {
  const keys = new Uint16Array(count),
    firsts = new Uint32Array(BUCKETS + 1),
    order = new Uint32Array(count);
  let low = Infinity,
    high = -Infinity;
  for (let n = 0; n < count; n++) {
    low = Math.min(low, rows[ROW * n]);
    high = Math.max(high, rows[ROW * n]);
  }
  const scale = (BUCKETS - 1) / Math.max(Math.log(high / low), 1e-9);
  for (let n = 0; n < count; n++) {
    keys[n] = scale * Math.log(rows[ROW * n] / low);
    firsts[keys[n] + 1]++;
  }
  for (let k = 0; k < BUCKETS; k++) firsts[k + 1] += firsts[k];
  for (let n = 0; n < count; n++) order[firsts[keys[n]]++] = n;
  return order;
}

/** Blends one Gaussian behind the earlier ones. `radiance` has RGB and the transmittance of each pixel. */
function splat(rows: Float32Array, at: number, radiance: Float32Array, width: number, height: number): void {
  const px = rows[at + 1],
    py = rows[at + 2],
    a = rows[at + 3],
    b = rows[at + 4],
    c = rows[at + 5],
    high = rows[at + 6],
    opacity = rows[at + 7];
  const red = rows[at + 8],
    green = rows[at + 9],
    blue = rows[at + 10],
    reach = 2 * Math.log(opacity * 255);
  for (let y = Math.max(Math.ceil(py - high - 0.5), 0), last = Math.min(py + high - 0.5, height - 1); y <= last; y++) {
    const dy = y + 0.5 - py,
      inside = b * b * dy * dy - a * (c * dy * dy - reach);
    if (inside <= 0) continue;
    const middle = px - (b * dy) / a - 0.5,
      half = Math.sqrt(inside) / a,
      end = Math.min(middle + half, width - 1);
    for (let x = Math.max(Math.ceil(middle - half), 0); x <= end; x++) {
      const p = 4 * (y * width + x),
        passes = radiance[p + 3];
      if (passes < OPAQUE) continue;
      const dx = x + 0.5 - px,
        q = a * dx * dx + 2 * b * dx * dy + c * dy * dy;
      const alpha = Math.min(opacity * FALLOFF[Math.min((q * (STEPS / MAX_EXPONENT)) | 0, STEPS)], 0.99),
        weight = alpha * passes;
      radiance[p] += weight * red;
      radiance[p + 1] += weight * green;
      radiance[p + 2] += weight * blue;
      radiance[p + 3] = passes - weight;
    }
  }
}
