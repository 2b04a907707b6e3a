// Nothing is invented: what arrived grows over the holes. The twin of `splatwire.conceal.grow`.

import type { Pause } from "../turns.ts";
import type { Elements } from "./elements.ts";
import { KdTree } from "./kd_tree.ts";

const NEIGHBOURS = 64,
  AT_A_TIME = 256,
  MAX_GAIN = 4,
  SMALLEST = 1e-9;
const SIZE_EXPONENT = 0.12,
  OPACITY_EXPONENT = 0.8,
  MOST_OPAQUE = 0.999,
  LEAST_OPAQUE = 1e-6;

/**
 * How elements without an opacity of their own grow: the power of the share that is left, and the limit as a multiple
 * of what the scene's loss would give.
 */
export interface Rule {
  readonly exponent: number;
  readonly maxExcess: number;
}

export const RULE: Rule = { exponent: 0.5, maxExcess: 1.08 };

/** Share that is lost, by size, among neighbours; 0 where there is none. */
export function lostShare({ sizes, tierSizes, known }: Elements, near: Int32Array): number {
  const weights = tierSizes ?? sizes;
  let all = 0,
    lost = 0;
  for (const j of near) {
    const weight = Math.max(weights[j], SMALLEST);
    all += weight;
    if (!known[j]) lost += weight;
  }
  return all > 0 ? lost / all : 0;
}

/** Share of the scene that was received: of its elements, or of the sizes that their tiers have. */
export function receivedShare({ tierSizes, known }: Elements): number {
  let all = 0,
    there = 0;
  known.forEach((received, i) => {
    const weight = tierSizes ? tierSizes[i] : 1;
    all += weight;
    there += received * weight;
  });
  return there / all;
}

/** Size gain where so much is left around, of a scene of which so much is there. */
export function gainsLeft(left: number, there: number, rule: Rule): number {
  return limited(left, there, rule) ** -rule.exponent;
}

function limited(left: number, there: number, { exponent, maxExcess }: Rule): number {
  const most = Math.min(MAX_GAIN, maxExcess * there ** -exponent);
  return Math.max(left, exponent ? most ** (-1 / exponent) : 1);
}

/**
 * Elements that have no opacity of their own grow by `(1 - rho) ** -0.5`, rho being the share lost among the nearest
 * 64, by size. Of others the opacity o grows, to `1 - (1 - o) ** (1 - rho) ** -0.8` and the size by `(1 - rho) **
 * -0.12`; rho is limited by what the loss of the whole scene would give.
 */
export async function grow(elements: Elements, pause: Pause, rule: Rule = RULE): Promise<Float32Array | null> {
  const { positions, opacities, known, places } = elements,
    count = known.length,
    gains = new Float32Array(2 * count).fill(1);
  const received = known.reduce((sum, there) => sum + there, 0);
  if (received === 0 || received === count) return gains;
  const tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), places),
    share = receivedShare(elements);
  for (let i = 0; i < count; i++) {
    if (i % AT_A_TIME === 0 && !(await pause())) return null;
    if (!known[i]) continue;
    const left = 1 - lostShare(elements, tree.nearestOthers(i));
    if (!opacities) {
      gains[2 * i] = gainsLeft(left, share, rule);
      continue;
    }
    const opacity = opacities[i],
      there = limited(left, share, rule);
    const opaque = 1 - (1 - Math.min(opacity, MOST_OPAQUE)) ** (there ** -OPACITY_EXPONENT);
    gains[2 * i] = there ** -SIZE_EXPONENT;
    gains[2 * i + 1] = Math.max(opaque / Math.max(opacity, LEAST_OPAQUE), 1);
  }
  return gains;
}
