// Default viewpoint of scenes without one: the whole scene fits, and nothing blocks the view.

import type { Quat } from "playcanvas";
import type { BoundingSphere } from "../codec/decoder.ts";
import type { FreeSpace } from "./free_space.ts";
import type { Orbit } from "./orbit.ts";
import { HALF_FLOAT_VALUES, type Packed } from "./packed.ts";
import type { SceneCore } from "./scene_core.ts";

const SAMPLES = 6000;
/** Least opacity of Gaussians that must fit. */
const MIN_OPACITY = 0.1;
/** Quantile of distances that defines the radius, and its upper bound as a multiple of the median distance. */
const RADIUS_QUANTILE = 0.998,
  MAX_RADIUS_RATIO = 5;
/** Share of samples that may lie outside on each side, radii per sample that must fit, and margin factor. */
const OUTSIDE_SHARE = 0.002,
  SAMPLE_RADII = 2,
  MARGIN = 1.04;
/** Least visibility of a usual viewpoint relative to the best one, and number of test points. */
const MIN_VISIBILITY = 0.6,
  NUM_TEST_POINTS = 150;
const YAWS = [0, 1, -1, 2, -2, 3, -3, 4].map((n) => (n * Math.PI) / 4),
  DISTANCE_FACTORS = [1, 0.6, 0.35, 0.2];

/** Returns the main part of a scene, without faint Gaussians and distant outliers. */
export function sceneCore(parts: readonly Packed[]): SceneCore {
  const count = parts.reduce((sum, part) => sum + part.count, 0),
    step = Math.max(Math.floor(count / SAMPLES), 1),
    found = sampleGaussians(parts, step, MIN_OPACITY),
    samples = found.length ? found : sampleGaussians(parts, step, 0),
    n = samples.length / 4;
  const axis = (a: number): number[] => Array.from({ length: n }, (_, i) => samples[4 * i + a]),
    middle = [0, 1, 2].map((a) => quantile(axis(a), 0.5));
  const far = Array.from({ length: n }, (_, i) =>
      Math.hypot(samples[4 * i] - middle[0], samples[4 * i + 1] - middle[1], samples[4 * i + 2] - middle[2]),
    ),
    half = quantile(far, 0.5),
    radius = Math.max(Math.min(quantile(far, RADIUS_QUANTILE), MAX_RADIUS_RATIO * half), 1e-6);
  const inside = far.flatMap((distance, i) => (distance <= radius ? [...samples.subarray(4 * i, 4 * i + 4)] : []));
  return { samples: Float32Array.from(inside), middle, medianRadius: half, radius };
}

function sampleGaussians(parts: readonly Packed[], step: number, least: number): Float32Array {
  const found: number[] = [];
  for (const { centers, scales, opacities, count } of parts) {
    for (let i = 0; i < count; i += step) {
      if (opacities[i] < least) continue;
      const [, b, c] = [0, 1, 2].map((a) => HALF_FLOAT_VALUES[scales[4 * i + a]]).sort((x, y) => x - y);
      found.push(centers[4 * i], centers[4 * i + 1], centers[4 * i + 2], Math.sqrt(b * c));
    }
  }
  return Float32Array.from(found);
}

/** View direction, and half the width and height of the window at distance 1. */
interface Frustum {
  readonly axes: readonly (readonly number[])[];
  readonly across: number;
  readonly down: number;
}

/** Returns the target and distance at which a scene fits exactly within the four sides of the view frustum. */
export function fitDistance(
  { samples }: SceneCore,
  { axes, across, down }: Frustum,
): { target: number[]; distance: number } {
  const [x, y, z] = axes.map((axis) =>
    Array.from(
      { length: samples.length / 4 },
      (_, i) => axis[0] * samples[4 * i] + axis[1] * samples[4 * i + 1] + axis[2] * samples[4 * i + 2],
    ),
  );
  const most = (side: number[], sign: number, half: number): number =>
    quantile(
      side.map((value, i) => sign * value + half * z[i] + SAMPLE_RADII * samples[4 * i + 3]),
      1 - OUTSIDE_SHARE,
    );
  const [left, right, low, high] = [most(x, -1, across), most(x, 1, across), most(y, -1, down), most(y, 1, down)];
  const middle = (quantile(z, 1 - OUTSIDE_SHARE) + quantile(z, OUTSIDE_SHARE)) / 2,
    eye = Math.max((left + right) / (2 * across), (low + high) / (2 * down)),
    place = [(right - left) / 2, (high - low) / 2, middle];
  const target = [0, 1, 2].map((a) => place.reduce((sum, value, k) => sum + value * axes[k][a], 0));
  return { target, distance: Math.max(MARGIN * (eye - middle), 1e-6) };
}

/**
 * Places the camera so that the scene fits the window. It starts from the usual direction unless little of the scene's
 * inner half is visible from there, as in rooms, where walls block the view from outside. A moving scene fits within
 * `extent`.
 */
export function frameScene(
  orbit: Orbit,
  core: SceneCore,
  space: FreeSpace,
  across: number,
  down: number,
  extent: BoundingSphere = core,
): void {
  const { yaw, pitch } = orbit.defaultDirection,
    inner = innerSamples(core);
  const fits = YAWS.map((turn) => {
    const lens = { axes: cameraAxes(orbit.rotation(yaw + turn, pitch)), across, down };
    return { turn, lens, ...fitDistance(core, lens) };
  });
  const candidates = DISTANCE_FACTORS.flatMap((nearer) =>
    fits.map(({ turn, lens, target, distance }) => {
      const eye = target.map((value, a) => value + nearer * distance * lens.axes[2][a]),
        ahead = space.isFree(eye) ? inner.filter((point) => isVisible(lens, eye, point)) : [],
        seen = ahead.reduce((sum, point) => sum + space.transmittance(eye, point), 0);
      return { target, distance: nearer * distance, yaw: yaw + turn, seen };
    }),
  );
  const most = Math.max(...candidates.map(({ seen }) => seen)),
    { target, distance, yaw: found } = candidates.find(({ seen }) => seen >= MIN_VISIBILITY * most)!;
  orbit.begin(
    target.map((value, a) => value + extent.middle[a] - core.middle[a]),
    distance * Math.max(extent.radius / core.radius, 1),
    found,
  );
}

function isVisible({ axes, across, down }: Frustum, eye: readonly number[], point: readonly number[]): boolean {
  const [x, y, back] = axes.map((axis) => axis.reduce((sum, value, a) => sum + value * (point[a] - eye[a]), 0));
  return back < 0 && Math.abs(x) <= -across * back && Math.abs(y) <= -down * back;
}

/** Returns some samples of the inner half. */
function innerSamples({ samples, middle, medianRadius }: SceneCore): number[][] {
  const found: number[][] = [];
  for (let i = 0; i < samples.length; i += 4) {
    const point = [...samples.subarray(i, i + 3)];
    if (Math.hypot(...point.map((value, a) => value - middle[a])) <= medianRadius) found.push(point);
  }
  const step = Math.max(Math.floor(found.length / NUM_TEST_POINTS), 1);
  return found.filter((_, n) => n % step === 0);
}

/** Returns the camera's right, up and backward axes. */
function cameraAxes({ x, y, z, w }: Quat): number[][] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** Returns a quantile, by quickselect. */
function quantile(values: readonly number[], share: number): number {
  const found = Float64Array.from(values),
    place = Math.floor((values.length - 1) * share);
  for (let low = 0, high = values.length - 1; low < high; ) {
    const middle = found[place];
    let i = low,
      j = high;
    while (i <= j) {
      while (found[i] < middle) i++;
      while (found[j] > middle) j--;
      if (i <= j) [found[i++], found[j--]] = [found[j], found[i]];
    }
    if (j < place) low = i;
    if (place < i) high = j;
  }
  return found[place] ?? 0;
}
