// Where a scene is looked at whose stream does not say it.

import type { Orbit } from "./orbit.ts";
import type { Packed } from "./packed.ts";

const SAMPLES = 4000;

/**
 * Frames what is there: the middle, and nine tenths of the Gaussians around it, of which some thousand are looked at.
 */
export function frameSplats(orbit: Orbit, parts: readonly Packed[]): void {
  const count = parts.reduce((sum, part) => sum + part.count, 0),
    step = Math.max(Math.floor(count / SAMPLES), 1),
    points: number[][] = [];
  for (const { centers } of parts) {
    for (let i = 0; i < centers.length; i += 4 * step) points.push([centers[i], centers[i + 1], centers[i + 2]]);
  }
  const middle = [0, 1, 2].map((a) =>
    quantile(
      points.map((point) => point[a]),
      0.5,
    ),
  );
  orbit.frame(
    middle,
    quantile(
      points.map((point) => Math.hypot(point[0] - middle[0], point[1] - middle[1], point[2] - middle[2])),
      0.9,
    ),
  );
}

function quantile(values: number[], share: number): number {
  return values.sort((a, b) => a - b)[Math.floor((values.length - 1) * share)];
}
