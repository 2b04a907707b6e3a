// Nothing is invented: what arrived grows over the holes. The twin of `splatwire.conceal.grow`.

import type { Elements, Pause } from "./conceal.ts";
import { KdTree } from "./kd_tree.ts";

const NEIGHBOURS = 64, EXPONENT = 0.5, AT_A_TIME = 256, MAX_EXCESS = 1.08, MAX_GAIN = 4, SMALLEST = 1e-9;
const SIZE_EXPONENT = 0.12, OPACITY_EXPONENT = 0.8, MOST_OPAQUE = 0.999, LEAST_OPAQUE = 1e-6;

/**
 * Elements that have no opacity of their own grow by `(1 - rho) ** -0.5`, rho being the share lost among the nearest 64, by size. Of
 * others the opacity o grows, to `1 - (1 - o) ** (1 - rho) ** -0.8` and the size by
 * `(1 - rho) ** -0.12`; rho is limited by what the loss of the whole scene would give.
 */
export async function grow({ positions, sizes, opacities, known, places }: Elements, pause: Pause): Promise<Float32Array | null> {
  const count = known.length, gains = new Float32Array(2 * count).fill(1);
  const received = known.reduce((sum, there) => sum + there, 0);
  if (received === 0 || received === count) return gains;
  const most = Math.min(MAX_GAIN, MAX_EXCESS * (received / count) ** -EXPONENT), least = most ** (-1 / EXPONENT);
  const tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), places);
  for (let i = 0; i < count; i++) {
    if (i % AT_A_TIME === 0 && !(await pause())) return null;
    if (!known[i]) continue;
    let all = 0, lost = 0;
    for (const j of tree.nearestOthers(i)) {
      const weight = Math.max(sizes[j], SMALLEST);
      all += weight;
      if (!known[j]) lost += weight;
    }
    const left = all > 0 ? Math.max(1 - lost / all, least) : 1;
    if (!opacities) {
      gains[2 * i] = left ** -EXPONENT;
      continue;
    }
    const opacity = opacities[i];
    const opaque = 1 - (1 - Math.min(opacity, MOST_OPAQUE)) ** (left ** -OPACITY_EXPONENT);
    gains[2 * i] = left ** -SIZE_EXPONENT;
    gains[2 * i + 1] = Math.max(opaque / Math.max(opacity, LEAST_OPAQUE), 1);
  }
  return gains;
}
