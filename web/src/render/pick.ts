// How far away what somebody points at is.

import type { Camera } from "../model/camera.ts";
import { FLOATS, type Packed } from "./packed.ts";

const OPAQUE = 1 / 255,
  BLUR = 0.3;
/** So much of the light has to stop before something is there. */
const SOMETHING = 0.2;

/**
 * Depth at which half of the light of a pixel has come, null where next to nothing is there. The camera's lengths are
 * those of `parts`.
 */
export function depthAt(parts: readonly Packed[], camera: Camera, px: number, py: number): number | null {
  const [x, y, z] = camera.viewmat,
    { focal, width, height } = camera,
    met: [number, number][] = [];
  for (const { count, centers, scales, opacities } of parts) {
    for (let i = 0; i < count; i++) {
      const at = (row: readonly number[]): number =>
        row[0] * centers[4 * i] + row[1] * centers[4 * i + 1] + row[2] * centers[4 * i + 2] + row[3];
      const depth = at(z);
      if (depth <= 0.01) continue;
      const dx = width / 2 + (focal * at(x)) / depth - px,
        dy = height / 2 + (focal * at(y)) / depth - py,
        [, b, c] = [0, 1, 2].map((a) => FLOATS[scales[4 * i + a]]).sort((one, other) => one - other);
      const square = (focal / depth) ** 2 * b * c + BLUR,
        alpha = opacities[i] * Math.exp((-0.5 * (dx * dx + dy * dy)) / square);
      if (alpha >= OPAQUE) met.push([depth, alpha]);
    }
  }
  met.sort(([one], [other]) => one - other);
  const passed = met.reduce((left, [, alpha]) => left * (1 - alpha), 1),
    half = 1 - (1 - passed) / 2;
  if (1 - passed < SOMETHING) return null;
  let left = 1;
  for (const [depth, alpha] of met) if ((left *= 1 - alpha) <= half) return depth;
  return null;
}
