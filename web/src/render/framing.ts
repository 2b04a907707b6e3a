// Where a scene is looked at whose stream does not say it: from where all of it fits, and nothing stands before it.

import type { Quat } from "playcanvas";
import type { Ball } from "../codec/decoder.ts";
import type { Core } from "./core.ts";
import type { Orbit } from "./orbit.ts";
import { FLOATS, type Packed } from "./packed.ts";
import type { Space } from "./space.ts";

const SAMPLES = 6000;
/** What is fainter is no part of what has to fit. */
const FAINT = 0.1;
/** A scene ends where nearly all of it lies nearer, at most at so many times the distance of half of it. */
const MOST = 0.998,
  REACH = 5;
/** Share of it that may stand out on each side, the radii of each that have to fit, and room around all. */
const OUT = 0.002,
  RADII = 2,
  ROOM = 1.04;
/** How much of what is seen from the best place has to be seen from one that is more usual. */
const ENOUGH = 0.6,
  POINTS = 150;
const YAWS = [0, 1, -1, 2, -2, 3, -3, 4].map((n) => (n * Math.PI) / 4),
  NEARER = [1, 0.6, 0.35, 0.2];

/** What a scene is, without what is faint or far away from all else. */
export function coreOf(parts: readonly Packed[]): Core {
  const count = parts.reduce((sum, part) => sum + part.count, 0),
    step = Math.max(Math.floor(count / SAMPLES), 1),
    found = samplesOf(parts, step, FAINT),
    samples = found.length ? found : samplesOf(parts, step, 0),
    n = samples.length / 4;
  const axis = (a: number): number[] => Array.from({ length: n }, (_, i) => samples[4 * i + a]),
    middle = [0, 1, 2].map((a) => quantile(axis(a), 0.5));
  const far = Array.from({ length: n }, (_, i) =>
      Math.hypot(samples[4 * i] - middle[0], samples[4 * i + 1] - middle[1], samples[4 * i + 2] - middle[2]),
    ),
    half = quantile(far, 0.5),
    radius = Math.max(Math.min(quantile(far, MOST), REACH * half), 1e-6);
  const inside = far.flatMap((distance, i) => (distance <= radius ? [...samples.subarray(4 * i, 4 * i + 4)] : []));
  return { samples: Float32Array.from(inside), middle, half, radius };
}

function samplesOf(parts: readonly Packed[], step: number, least: number): Float32Array {
  const found: number[] = [];
  for (const { centers, scales, opacities, count } of parts) {
    for (let i = 0; i < count; i += step) {
      if (opacities[i] < least) continue;
      const [, b, c] = [0, 1, 2].map((a) => FLOATS[scales[4 * i + a]]).sort((x, y) => x - y);
      found.push(centers[4 * i], centers[4 * i + 1], centers[4 * i + 2], Math.sqrt(b * c));
    }
  }
  return Float32Array.from(found);
}

/** A direction of view and half of what the window shows at distance 1, across and down. */
interface Lens {
  readonly axes: readonly (readonly number[])[];
  readonly across: number;
  readonly down: number;
}

/** From which distance, and around which point, a scene fits; both exactly, for a pyramid has four sides. */
export function fit({ samples }: Core, { axes, across, down }: Lens): { target: number[]; distance: number } {
  const [x, y, z] = axes.map((axis) =>
    Array.from(
      { length: samples.length / 4 },
      (_, i) => axis[0] * samples[4 * i] + axis[1] * samples[4 * i + 1] + axis[2] * samples[4 * i + 2],
    ),
  );
  const most = (side: number[], sign: number, half: number): number =>
    quantile(
      side.map((value, i) => sign * value + half * z[i] + RADII * samples[4 * i + 3]),
      1 - OUT,
    );
  const [left, right, low, high] = [most(x, -1, across), most(x, 1, across), most(y, -1, down), most(y, 1, down)];
  const middle = (quantile(z, 1 - OUT) + quantile(z, OUT)) / 2,
    eye = Math.max((left + right) / (2 * across), (low + high) / (2 * down)),
    place = [(right - left) / 2, (high - low) / 2, middle];
  const target = [0, 1, 2].map((a) => place.reduce((sum, value, k) => sum + value * axes[k][a], 0));
  return { target, distance: Math.max(ROOM * (eye - middle), 1e-6) };
}

/**
 * Has a scene fit the window; from the usual side, unless little of its inner half is seen from there: whoever looks at
 * a room from outside sees walls. What moves fits wherever it goes within a ball that is its extent.
 */
export function frameScene(
  orbit: Orbit,
  core: Core,
  space: Space,
  across: number,
  down: number,
  extent: Ball = core,
): void {
  const { yaw, pitch } = orbit.usual,
    inner = innerOf(core);
  const fits = YAWS.map((turn) => {
    const lens = { axes: axesOf(orbit.rotation(yaw + turn, pitch)), across, down };
    return { turn, lens, ...fit(core, lens) };
  });
  const looks = NEARER.flatMap((nearer) =>
    fits.map(({ turn, lens, target, distance }) => {
      const eye = target.map((value, a) => value + nearer * distance * lens.axes[2][a]),
        ahead = space.free(eye) ? inner.filter((point) => inSight(lens, eye, point)) : [],
        seen = ahead.reduce((sum, point) => sum + space.light(eye, point), 0);
      return { target, distance: nearer * distance, yaw: yaw + turn, seen };
    }),
  );
  const most = Math.max(...looks.map(({ seen }) => seen)),
    { target, distance, yaw: found } = looks.find(({ seen }) => seen >= ENOUGH * most)!;
  orbit.begin(
    target.map((value, a) => value + extent.middle[a] - core.middle[a]),
    distance * Math.max(extent.radius / core.radius, 1),
    found,
  );
}

function inSight({ axes, across, down }: Lens, eye: readonly number[], point: readonly number[]): boolean {
  const [x, y, back] = axes.map((axis) => axis.reduce((sum, value, a) => sum + value * (point[a] - eye[a]), 0));
  return back < 0 && Math.abs(x) <= -across * back && Math.abs(y) <= -down * back;
}

/** Some points of the inner half. */
function innerOf({ samples, middle, half }: Core): number[][] {
  const found: number[][] = [];
  for (let i = 0; i < samples.length; i += 4) {
    const point = [...samples.subarray(i, i + 3)];
    if (Math.hypot(...point.map((value, a) => value - middle[a])) <= half) found.push(point);
  }
  const step = Math.max(Math.floor(found.length / POINTS), 1);
  return found.filter((_, n) => n % step === 0);
}

/** What is right, up and behind for a camera. */
function axesOf({ x, y, z, w }: Quat): number[][] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** Sorts only where the value lies. */
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
