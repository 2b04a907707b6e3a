// Concealer `grow`: enlarges received elements to cover lost ones. Counterpart of `splatwire.concealment.grow`.

import type { Pause } from "../scheduler.ts";
import type { Elements } from "./elements.ts";
import { KdTree } from "./kd_tree.ts";

const NEIGHBOURS = 64,
  BATCH = 256,
  MAX_GAIN = 4,
  MIN_SIZE = 1e-9;
const SIZE_EXPONENT = 0.12,
  OPACITY_EXPONENT = 0.8,
  MAX_OPACITY = 0.999,
  MIN_OPACITY = 1e-6;

/**
 * Growth of elements without individual opacity. The size gain is the received share to the power `-exponent`. It is at
 * most `maxExcess` times the gain for the whole scene's loss.
 */
export interface Rule {
  readonly exponent: number;
  readonly maxExcess: number;
}

/** Properties that the growth of elements depends on. */
export type GrowingElements = Pick<
  Elements,
  "positions" | "sizes" | "tierSizes" | "opacities" | "isReceived" | "indices"
>;

export const RULE: Rule = { exponent: 0.5, maxExcess: 1.08 };

/** Returns the lost share among neighbours, weighted by size; 0 without neighbours. */
export function lostShare({ sizes, tierSizes, isReceived }: GrowingElements, near: Int32Array): number {
  const weights = tierSizes ?? sizes;
  let all = 0,
    lost = 0;
  for (const j of near) {
    const weight = Math.max(weights[j], MIN_SIZE);
    all += weight;
    if (!isReceived[j]) lost += weight;
  }
  return all > 0 ? lost / all : 0;
}

/** Returns the received share of the scene, weighted by tier size if known. */
export function receivedShare({ tierSizes, isReceived }: GrowingElements): number {
  let all = 0,
    received = 0;
  isReceived.forEach((isOneReceived, i) => {
    const weight = tierSizes ? tierSizes[i] : 1;
    all += weight;
    received += isOneReceived * weight;
  });
  return received / all;
}

/** Returns the size gain for the received share among the neighbours and in the whole scene. */
export function sizeGain(localShare: number, sceneShare: number, rule: Rule): number {
  return boundedShare(localShare, sceneShare, rule) ** -rule.exponent;
}

function boundedShare(localShare: number, sceneShare: number, { exponent, maxExcess }: Rule): number {
  const maxGain = Math.min(MAX_GAIN, maxExcess * sceneShare ** -exponent);
  return Math.max(localShare, exponent ? maxGain ** (-1 / exponent) : 1);
}

/**
 * Gains of size and opacity.
 *
 * Let rho be the share, weighted by size, lost among the 64 nearest elements. Elements without individual opacity grow
 * by `(1 - rho) ** -0.5`. Otherwise the opacity o becomes `1 - (1 - o) ** (1 - rho) ** -0.8`, and the size grows by `(1
 * - rho) ** -0.12`. The loss of the whole scene limits rho.
 */
export class Growth {
  readonly #elements: GrowingElements;
  readonly #rule: Rule;
  readonly #tree: KdTree;
  readonly #share: number;

  constructor(elements: GrowingElements, rule: Rule = RULE) {
    this.#elements = elements;
    this.#rule = rule;
    const { positions, isReceived, indices } = elements;
    this.#tree = new KdTree(positions, Math.min(NEIGHBOURS, isReceived.length - 1), indices);
    this.#share = receivedShare(elements);
  }

  /** Returns the gains of size and opacity of a received element. */
  of(i: number): readonly [number, number] {
    const left = 1 - lostShare(this.#elements, this.#tree.nearestOthers(i));
    if (!this.#elements.opacities) return [sizeGain(left, this.#share, this.#rule), 1];
    const opacity = this.#elements.opacities[i],
      share = boundedShare(left, this.#share, this.#rule),
      opaque = 1 - (1 - Math.min(opacity, MAX_OPACITY)) ** (share ** -OPACITY_EXPONENT);
    return [share ** -SIZE_EXPONENT, Math.max(opaque / Math.max(opacity, MIN_OPACITY), 1)];
  }
}

/** Computes gains, shape (count, 2), of all elements. Resolves to null if the result is no longer needed. */
export async function grow(elements: Elements, pause: Pause, rule: Rule = RULE): Promise<Float32Array | null> {
  const { isReceived } = elements,
    count = isReceived.length,
    gains = new Float32Array(2 * count).fill(1);
  const numReceived = isReceived.reduce((sum, one) => sum + one, 0);
  if (numReceived === 0 || numReceived === count) return gains;
  const growth = new Growth(elements, rule);
  for (let i = 0; i < count; i++) {
    if (i % BATCH === 0 && !(await pause())) return null;
    if (isReceived[i]) gains.set(growth.of(i), 2 * i);
  }
  return gains;
}
