// A small network says how much of a loss sizes and how much opacities of received Gaussians make up for. The twin of
// `splatwire.conceal.scene_free.elements`.

import type { Pause } from "../turns.ts";
import type { Elements } from "./elements.ts";
import { KdTree } from "./kd_tree.ts";
import { perceptron } from "./perceptron.ts";
import { GAUSSIANS } from "./scene_free_weights.ts";

const NEIGHBOURS = 64,
  CLOSE = 32,
  NEAREST = 12,
  SPACING_RANK = 6,
  MOST_LOST = 0.97,
  SMALLEST = 1e-9,
  TINY = 2 ** -126,
  AT_A_TIME = 256;
const opinion = perceptron(GAUSSIANS);

/** Bounds of the exponents of what is lost: of size and of opacity. */
const LEAST = [-0.5, -0.5],
  MOST = [1, 2.5];
const LEAST_OPAQUE = 1e-4,
  MOST_OPAQUE = 1 - 1e-4,
  MOST_LOGIT = 6,
  MOST_THIN = 6;

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);
/** Logarithm of what makes up for a loss of this share. */
export const gainFor = (share: number): number => -Math.log1p(-Math.min(share, MOST_LOST));
const logit = (opacity: number): number => {
  const o = clip(opacity, LEAST_OPAQUE, MOST_OPAQUE);
  return clip(Math.log(o / (1 - o)), -MOST_LOGIT, MOST_LOGIT);
};

/** Exponents before the network changes them, and how much of its change is taken. */
export interface Growth {
  readonly base: readonly [number, number];
  readonly trust: number;
}

const GROWTH: Growth = { base: [0.15, 0.75], trust: 1 };

/** Gains of size and opacity in turn of all elements, explicit Gaussians; those of lost ones are 1. */
export async function sceneFree(
  elements: Elements,
  pause: Pause,
  { base, trust } = GROWTH,
): Promise<Float32Array | null> {
  const { positions, known, opacities, places } = elements,
    count = known.length,
    gains = new Float32Array(2 * count).fill(1);
  const received = known.reduce((sum, there) => sum + there, 0);
  if (received === 0 || received === count) return gains;
  const look = new Surroundings(elements, received),
    tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), places),
    signature = new Float64Array(GAUSSIANS.inputs);
  for (let i = 0; i < count; i++) {
    if (i % AT_A_TIME === 0 && !(await pause())) return null;
    if (!known[i]) continue;
    const near = tree.nearestFirst(i),
      lost = look.describe(i, near, tree.distances, signature),
      change = opinion(signature);
    const [size, power] = [0, 1].map((n) => Math.exp(lost * clip(base[n] + trust * change[n], LEAST[n], MOST[n])));
    const opacity = clip(opacities![i], LEAST_OPAQUE, MOST_OPAQUE);
    gains[2 * i] = size;
    gains[2 * i + 1] = -Math.expm1(power * Math.log1p(-opacity)) / opacity;
  }
  return gains;
}

/** What is seen of a received Gaussian: ratios only, no unit of length. */
class Surroundings {
  readonly #overall: number;
  readonly #typical: number;
  readonly #logs: Float64Array;
  readonly #areas: Float64Array;

  constructor(
    readonly elements: Elements,
    received: number,
  ) {
    const { sizes, known } = elements;
    this.#overall = gainFor(1 - received / known.length);
    this.#logs = Float64Array.from(sizes, (size) => Math.log(Math.max(size, SMALLEST)));
    this.#areas = this.#logs.map((log) => Math.exp(2 * log));
    this.#typical = this.#logs.filter((_, i) => known[i]).sort()[(received - 1) >> 1];
  }

  /** Fills `out`; gives the logarithm of what would make up for the loss around it. */
  describe(i: number, near: Int32Array, far: Float64Array, out: Float64Array): number {
    const { known, sizes, logScales } = this.elements,
      own = this.#logs[i],
      few = Math.min(near.length, NEAREST);
    let all = 0,
      gone = 0,
      soon = 0;
    for (let n = 0; n < near.length; n++) {
      const j = near[n],
        size = Math.max(sizes[j], SMALLEST);
      all += size;
      if (known[j]) continue;
      gone += size;
      if (n < few) soon++;
    }
    const lost = gainFor(gone / Math.max(all, TINY)),
      { mean, opaque, cover, covered, spacing } = this.#close(i, near, far);
    out[0] = lost;
    out[1] = gainFor(few ? soon / few : 0);
    out[2] = this.#overall;
    out[3] = own - spacing;
    out[4] = own - this.#typical;
    out[5] = own - mean;
    out[6] = Math.min(logScales![3 * i] - logScales![3 * i + 1], MOST_THIN);
    out[7] = Math.min(logScales![3 * i + 1] - logScales![3 * i + 2], MOST_THIN);
    out[8] = logit(this.elements.opacities![i]);
    out[9] = opaque;
    out[10] = Math.log1p(cover);
    out[11] = gainFor(covered);
    return lost;
  }

  /**
   * Of the nearest: means of the logarithms of size and of the opacity's logits, how much they cover, the share of that
   * which is lost, the spacing.
   */
  #close(
    i: number,
    near: Int32Array,
    far: Float64Array,
  ): Record<"mean" | "opaque" | "cover" | "covered" | "spacing", number> {
    const { known, opacities } = this.elements,
      areas = this.#areas,
      end = Math.min(near.length, CLOSE);
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
        reach = (distance / Math.max(Math.sqrt(areas[j] + areas[i]), SMALLEST)) ** 2;
      const weight = areas[j] * Math.exp(-reach / 4);
      weights += weight;
      if (!known[j]) {
        lost += weight;
        continue;
      }
      if (++there === SPACING_RANK) spacing = Math.log(Math.max(distance, SMALLEST));
      logs += this.#logs[j];
      logits += logit(opacities![j]);
      cover += opacities![j] * Math.exp(-reach / 2);
    }
    const some = Math.max(there, 1);
    return {
      mean: logs / some,
      opaque: logits / some,
      cover,
      covered: lost / Math.max(weights + areas[i], TINY),
      spacing,
    };
  }
}
