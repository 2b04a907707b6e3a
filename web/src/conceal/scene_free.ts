// Concealer `scene_free` for explicit Gaussians: a small network predicts how much sizes and opacities must grow.
// Counterpart of `splatwire.concealment.scene_free.elements`.

import type { Pause } from "../scheduler.ts";
import type { Elements } from "./elements.ts";
import { KdTree } from "./kd_tree.ts";
import { perceptron } from "./perceptron.ts";
import { GAUSSIANS } from "./scene_free_weights.ts";

const NEIGHBOURS = 64,
  STATISTICS_NEIGHBOURS = 32,
  COUNTED_NEIGHBOURS = 12,
  SPACING_RANK = 6,
  MAX_LOST_SHARE = 0.97,
  MIN_SIZE = 1e-9,
  MIN_SUM = 2 ** -126,
  BATCH = 256;

/** Bounds of the exponents of size and opacity. */
const MIN_EXPONENTS = [-0.5, -0.5],
  MAX_EXPONENTS = [1, 2.5];
const MIN_OPACITY = 1e-4,
  MAX_OPACITY = 1 - 1e-4,
  MAX_LOGIT = 6,
  MAX_LOG_RATIO = 6;

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);
/** Returns the log gain that compensates a lost share. */
export const logGain = (share: number): number => -Math.log1p(-Math.min(share, MAX_LOST_SHARE));
const logit = (opacity: number): number => {
  const o = clip(opacity, MIN_OPACITY, MAX_OPACITY);
  return clip(Math.log(o / (1 - o)), -MAX_LOGIT, MAX_LOGIT);
};

/** Exponents before the network's correction, and the weight of that correction. */
export interface Growth {
  readonly base: readonly [number, number];
  readonly trust: number;
}

const GROWTH: Growth = { base: [0.15, 0.75], trust: 1 };

/**
 * Computes gains of size and opacity, shape (count, 2), of explicit Gaussians. Those of lost elements are 1. Resolves
 * to null if the result is no longer needed.
 */
export async function sceneFree(
  elements: Elements,
  pause: Pause,
  { base, trust } = GROWTH,
): Promise<Float32Array | null> {
  const { positions, isReceived, opacities, indices } = elements,
    count = isReceived.length,
    gains = new Float32Array(2 * count).fill(1);
  const numReceived = isReceived.reduce((sum, one) => sum + one, 0);
  if (numReceived === 0 || numReceived === count) return gains;
  const features = new NeighbourhoodFeatures(elements, numReceived),
    tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), indices),
    network = perceptron(GAUSSIANS),
    signature = new Float64Array(GAUSSIANS.inputs);
  for (let i = 0; i < count; i++) {
    if (i % BATCH === 0 && !(await pause())) return null;
    if (!isReceived[i]) continue;
    const near = tree.nearestFirst(i),
      lost = features.describe(i, near, tree.distances, signature),
      change = network(signature);
    const [size, power] = [0, 1].map((n) =>
      Math.exp(lost * clip(base[n] + trust * change[n], MIN_EXPONENTS[n], MAX_EXPONENTS[n])),
    );
    const opacity = clip(opacities![i], MIN_OPACITY, MAX_OPACITY);
    gains[2 * i] = size;
    gains[2 * i + 1] = -Math.expm1(power * Math.log1p(-opacity)) / opacity;
  }
  return gains;
}

/** Network inputs of received Gaussians. All are ratios and therefore independent of the unit of length. */
class NeighbourhoodFeatures {
  readonly #sceneLogGain: number;
  readonly #medianLogSize: number;
  readonly #logs: Float64Array;
  readonly #areas: Float64Array;

  constructor(
    readonly elements: Elements,
    numReceived: number,
  ) {
    const { sizes, isReceived } = elements;
    this.#sceneLogGain = logGain(1 - numReceived / isReceived.length);
    this.#logs = Float64Array.from(sizes, (size) => Math.log(Math.max(size, MIN_SIZE)));
    this.#areas = this.#logs.map((log) => Math.exp(2 * log));
    this.#medianLogSize = this.#logs.filter((_, i) => isReceived[i]).sort()[(numReceived - 1) >> 1];
  }

  /** Writes the inputs of element `i` to `out`. Returns the log gain that would compensate the loss around it. */
  describe(i: number, near: Int32Array, far: Float64Array, out: Float64Array): number {
    const { isReceived, sizes, logScales } = this.elements,
      own = this.#logs[i],
      few = Math.min(near.length, COUNTED_NEIGHBOURS);
    let all = 0,
      gone = 0,
      lostNearest = 0;
    for (let n = 0; n < near.length; n++) {
      const j = near[n],
        size = Math.max(sizes[j], MIN_SIZE);
      all += size;
      if (isReceived[j]) continue;
      gone += size;
      if (n < few) lostNearest++;
    }
    const lost = logGain(gone / Math.max(all, MIN_SUM)),
      { mean, opaque, cover, covered, spacing } = this.#statistics(i, near, far);
    out[0] = lost;
    out[1] = logGain(few ? lostNearest / few : 0);
    out[2] = this.#sceneLogGain;
    out[3] = own - spacing;
    out[4] = own - this.#medianLogSize;
    out[5] = own - mean;
    out[6] = Math.min(logScales![3 * i] - logScales![3 * i + 1], MAX_LOG_RATIO);
    out[7] = Math.min(logScales![3 * i + 1] - logScales![3 * i + 2], MAX_LOG_RATIO);
    out[8] = logit(this.elements.opacities![i]);
    out[9] = opaque;
    out[10] = Math.log1p(cover);
    out[11] = logGain(covered);
    return lost;
  }

  /**
   * Statistics of the nearest elements: mean log size, mean logit of opacity, coverage, lost share of the coverage, log
   * spacing.
   */
  #statistics(
    i: number,
    near: Int32Array,
    far: Float64Array,
  ): Record<"mean" | "opaque" | "cover" | "covered" | "spacing", number> {
    const { isReceived, opacities } = this.elements,
      areas = this.#areas,
      end = Math.min(near.length, STATISTICS_NEIGHBOURS);
    let there = 0,
      logs = 0,
      logits = 0,
      cover = 0,
      weights = 0,
      lost = 0,
      spacing = this.#logs[i];
    for (let n = 0; n < end; n++) {
      const j = near[n],
        distance = Math.sqrt(far[n]),
        reach = (distance / Math.max(Math.sqrt(areas[j] + areas[i]), MIN_SIZE)) ** 2;
      const weight = areas[j] * Math.exp(-reach / 4);
      weights += weight;
      if (!isReceived[j]) {
        lost += weight;
        continue;
      }
      if (++there === SPACING_RANK) spacing = Math.log(Math.max(distance, MIN_SIZE));
      logs += this.#logs[j];
      logits += logit(opacities![j]);
      cover += opacities![j] * Math.exp(-reach / 2);
    }
    const some = Math.max(there, 1);
    return {
      mean: logs / some,
      opaque: logits / some,
      cover,
      covered: lost / Math.max(weights + areas[i], MIN_SUM),
      spacing,
    };
  }
}
