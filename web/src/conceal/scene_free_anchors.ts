// Concealer `scene_free` for anchors: a small network corrects the gains of `grow` and predicts those of opacity.
// Counterpart of `splatwire.concealment.scene_free.network` and `signature`.

import type { Pause } from "../scheduler.ts";
import type { Elements } from "./elements.ts";
import { lostShare, RULE, type Rule, receivedShare, sizeGain } from "./grow.ts";
import { KdTree } from "./kd_tree.ts";
import { perceptron } from "./perceptron.ts";
import { logGain } from "./scene_free.ts";
import { ANCHORS } from "./scene_free_weights.ts";

const NEIGHBOURS = 64,
  STATISTICS_NEIGHBOURS = 32,
  COUNTS = [4, 12, 32],
  REACHES = [1, 4, 16],
  MIDDLE_REACH = 4,
  SPACING_RANK = 5;
const CLASS_NEIGHBOURS = 12,
  CLASS_SHARES = [8, 64],
  MIN_CLASS = 8,
  BATCH = 128,
  MIN_LENGTH = 1e-9,
  MIN_SUM = 2 ** -126,
  MIN_GAUSSIANS = 0.5;
const MAX_CORRECTION = 0.3,
  CORRECTION_WEIGHT = 0.5;

/**
 * Computes gains of size and opacity, shape (count, 2), of anchors. Those of lost elements are 1. `trust` weights the
 * network's correction. Resolves to null if the result is no longer needed.
 */
export async function sceneFreeAnchors(
  elements: Elements,
  pause: Pause,
  rule: Rule = RULE,
  trust = CORRECTION_WEIGHT,
): Promise<Float32Array | null> {
  const { positions, isReceived, indices } = elements,
    count = isReceived.length,
    gains = new Float32Array(2 * count).fill(1);
  const numReceived = isReceived.reduce((sum, one) => sum + one, 0);
  if (numReceived === 0 || numReceived === count) return gains;
  const features = new NeighbourhoodFeatures(elements, numReceived),
    there = receivedShare(elements),
    tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), indices),
    network = perceptron(ANCHORS),
    signature = new Float64Array(ANCHORS.inputs);
  for (let i = 0; i < numReceived; i++) {
    if (i % BATCH === 0 && !(await pause())) return null;
    const near = tree.nearestFirst(i),
      grown = sizeGain(1 - lostShare(elements, near), there, rule);
    features.describe(i, near, tree.distances, signature);
    const [size, opacity] = network(signature).map((change) =>
      Math.exp(trust * Math.min(Math.max(change, -MAX_CORRECTION), MAX_CORRECTION)),
    );
    gains[2 * i] = grown * size;
    gains[2 * i + 1] = opacity;
  }
  return gains;
}

/**
 * The largest anchors of a scene. A hole left by one of them is covered by others of this class, which are often not
 * among the nearest neighbours.
 */
class SizeClass {
  readonly #tree: KdTree;

  constructor(
    readonly elements: Elements,
    readonly members: Int32Array,
  ) {
    const points = Float32Array.from(
      { length: 3 * members.length },
      (_, n) => elements.positions[3 * members[Math.floor(n / 3)] + (n % 3)],
    );
    this.#tree = new KdTree(
      points,
      Math.min(CLASS_NEIGHBOURS, members.length),
      members.map((member) => elements.indices[member]),
    );
  }

  /** Returns the class members nearest to element `i`, including itself, and their squared distances. */
  near(i: number): { indices: Int32Array; far: Float64Array } {
    const { positions } = this.elements,
      found = this.#tree.nearest(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
    return { indices: found.map((member) => this.members[member]), far: this.#tree.distances };
  }
}

/** Network inputs of received anchors. All are ratios and therefore independent of the unit of length. */
class NeighbourhoodFeatures {
  readonly #logs: Float64Array;
  readonly #areas: Float64Array;
  readonly #classes: readonly SizeClass[];
  readonly #sceneLogGain: number;
  readonly #medianLogSize: number;
  readonly #minLogSize: number;

  constructor(
    readonly elements: Elements,
    numReceived: number,
  ) {
    const { sizes, indices } = elements,
      count = sizes.length;
    this.#logs = Float64Array.from(sizes, (size) => Math.log(Math.max(size, MIN_LENGTH)));
    this.#areas = this.#logs.map((log) => Math.exp(2 * log));
    this.#sceneLogGain = logGain(1 - numReceived / count);
    this.#medianLogSize = this.#logs.slice().sort()[(count - 1) >> 1];
    this.#minLogSize = this.#logs.reduce((least, log) => Math.min(least, log), Infinity);
    const bySize = Int32Array.from({ length: count }, (_, i) => i).sort(
      (a, b) => sizes[b] - sizes[a] || indices[a] - indices[b],
    );
    this.#classes = CLASS_SHARES.map(
      (share) => new SizeClass(elements, bySize.slice(0, Math.max(Math.floor(count / share), MIN_CLASS))),
    );
  }

  /** Writes the inputs of element `i` to `out`, given its nearest neighbours and their squared distances. */
  describe(i: number, near: Int32Array, far: Float64Array, out: Float64Array): void {
    const { isReceived } = this.elements,
      { logs, numGaussians, expectedErrors } = this.elements.anchors!(),
      areas = this.#areas,
      expected = this.#logs[i];
    const lengths = [0, 1, 2, 3].map((n) => Math.max(logs[4 * i + n], this.#minLogSize)),
      own = (lengths[1] + lengths[2] + lengths[3]) / 3;
    const close = near.subarray(0, STATISTICS_NEIGHBOURS),
      end = close.length,
      own2 = Math.exp(2 * own);
    out[0] = this.#sceneLogGain;
    COUNTS.forEach((count, n) => (out[1 + n] = logGain(lostShareByNumber(isReceived, close.subarray(0, count)))));
    let at = 4;
    for (const reach of REACHES) {
      const { lost, all } = this.#lostArea(i, close, far, reach);
      out[at++] = logGain(lost / Math.max(all, MIN_SUM));
      if (reach === MIDDLE_REACH) out[at++] = Math.log1p(lost / own2);
    }
    let all = 0,
      lost = 0,
      actives = 0,
      there = 0;
    for (const j of close) {
      all += areas[j];
      if (isReceived[j]) {
        actives += numGaussians[j];
        there++;
      } else lost += areas[j];
    }
    out[at++] = logGain(lost / Math.max(all, MIN_SUM));
    for (const members of this.#classes) {
      const { indices, far } = members.near(i),
        { lost, all } = this.#lostArea(i, indices, far, MIDDLE_REACH);
      out[at++] = logGain(lostShareByNumber(isReceived, indices));
      out[at++] = logGain(lost / Math.max(all, MIN_SUM));
      out[at++] = Math.log1p(lost / own2);
    }
    const spacing = end ? logDistance(far[Math.min(SPACING_RANK, end - 1)]) : expected,
      farthest = end ? logDistance(far[end - 1]) : expected;
    out[at++] = own - spacing;
    out[at++] = lengths[0] - spacing;
    out[at++] = Math.max(lengths[1], lengths[2], lengths[3]) - own;
    out[at++] = expected - spacing;
    out[at++] = expected - this.#medianLogSize;
    out[at++] = farthest - spacing;
    out[at++] = Math.log(Math.max(numGaussians[i], MIN_GAUSSIANS));
    out[at++] = Math.log(Math.max(actives / Math.max(there, 1), MIN_GAUSSIANS));
    out[at++] = own - expected;
    out[at++] = expectedErrors[2 * i];
    out[at++] = expectedErrors[2 * i + 1];
  }

  /**
   * Sums the areas of the neighbours, attenuated by distance in relation to the sizes. `lost` is the sum over lost
   * ones, `all` that over all including element `i`.
   */
  #lostArea(i: number, near: Int32Array, far: Float64Array, reach: number): { lost: number; all: number } {
    const { isReceived } = this.elements,
      areas = this.#areas;
    let lost = 0,
      all = areas[i];
    for (let n = 0; n < near.length; n++) {
      const j = near[n],
        weight = areas[j] * Math.exp(-far[n] / (2 * (areas[j] + areas[i]) * reach));
      all += weight;
      if (!isReceived[j]) lost += weight;
    }
    return { lost, all };
  }
}

const logDistance = (square: number): number => Math.log(Math.max(Math.sqrt(square), MIN_LENGTH));

/** Returns the lost share by number. */
function lostShareByNumber(isReceived: Uint8Array, near: Int32Array): number {
  let lost = 0;
  for (const j of near) lost += isReceived[j] ? 0 : 1;
  return lost / Math.max(near.length, 1);
}
