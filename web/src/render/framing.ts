// Where a scene is looked at whose stream does not say it.

import type { Splats } from "../codec/splats.ts";
import type { Orbit } from "./orbit.ts";

const SAMPLES = 4000;

/** Frames what is there: the middle, and nine tenths of the Gaussians around it, of which some thousand are looked at; in units of `size`. */
export function frameSplats(orbit: Orbit, parts: readonly Splats[], size: number): void {
  const count = parts.reduce((sum, part) => sum + part.count, 0), step = Math.max(Math.floor(count / SAMPLES), 1), points: number[][] = [];
  for (const { means } of parts) {
    for (let i = 0; i < means.length; i += 3 * step) points.push([means[i] / size, means[i + 1] / size, means[i + 2] / size]);
  }
  const middle = [0, 1, 2].map((a) => quantile(points.map((point) => point[a]), 0.5));
  orbit.frame(middle, quantile(points.map((point) => Math.hypot(point[0] - middle[0], point[1] - middle[1], point[2] - middle[2])), 0.9));
}

function quantile(values: number[], share: number): number {
  return values.sort((a, b) => a - b)[Math.floor((values.length - 1) * share)];
}
