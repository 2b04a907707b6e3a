// The small network for anchors: it corrects the growth of `grow`, and says how opaque Gaussians become. The twin of
// `splatwire.conceal.scene_free.network` and `signature`.

import type { Pause } from "../turns.ts";
import type { Elements } from "./elements.ts";
import { gainsLeft, lostShare, RULE, type Rule, receivedShare } from "./grow.ts";
import { KdTree } from "./kd_tree.ts";
import { perceptron } from "./perceptron.ts";
import { gainFor } from "./scene_free.ts";
import { ANCHORS } from "./scene_free_weights.ts";

const NEIGHBOURS = 64,
  CLOSE = 32,
  COUNTS = [4, 12, 32],
  REACHES = [1, 4, 16],
  MIDDLE_REACH = 4,
  SPACING_RANK = 5;
const CLASS_NEIGHBOURS = 12,
  CLASS_SHARES = [8, 64],
  MIN_CLASS = 8,
  AT_A_TIME = 128,
  SMALLEST = 1e-9,
  TINY = 2 ** -126,
  FEWEST = 0.5;
const MOST_CHANGE = 0.3,
  TRUST = 0.5;
const opinion = perceptron(ANCHORS);

/**
 * Gains of size and opacity in turn of all elements, anchors; those of lost ones are 1. `trust` is how much of the
 * network's correction is taken.
 */
export async function sceneFreeAnchors(
  elements: Elements,
  pause: Pause,
  rule: Rule = RULE,
  trust = TRUST,
): Promise<Float32Array | null> {
  const { positions, known, places } = elements,
    count = known.length,
    gains = new Float32Array(2 * count).fill(1);
  const received = known.reduce((sum, there) => sum + there, 0);
  if (received === 0 || received === count) return gains;
  const look = new Surroundings(elements, received),
    there = receivedShare(elements),
    tree = new KdTree(positions, Math.min(NEIGHBOURS, count - 1), places),
    signature = new Float64Array(ANCHORS.inputs);
  for (let i = 0; i < received; i++) {
    if (i % AT_A_TIME === 0 && !(await pause())) return null;
    const near = tree.nearestFirst(i),
      grown = gainsLeft(1 - lostShare(elements, near), there, rule);
    look.describe(i, near, tree.distances, signature);
    const [size, opacity] = opinion(signature).map((change) =>
      Math.exp(trust * Math.min(Math.max(change, -MOST_CHANGE), MOST_CHANGE)),
    );
    gains[2 * i] = grown * size;
    gains[2 * i + 1] = opacity;
  }
  return gains;
}

/**
 * The largest anchors: what covers a hole that one of them left is the others, of which the nearest neighbours say
 * nothing.
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
      members.map((member) => elements.places[member]),
    );
  }

  /** The nearest members of where an element lies, itself if it is one; squares of their distances. */
  near(i: number): { who: Int32Array; far: Float64Array } {
    const { positions } = this.elements,
      found = this.#tree.nearest(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
    return { who: found.map((member) => this.members[member]), far: this.#tree.distances };
  }
}

/** What is seen of a received anchor, the first so many elements: ratios only, no unit of length. */
class Surroundings {
  readonly #logs: Float64Array;
  readonly #areas: Float64Array;
  readonly #classes: readonly SizeClass[];
  readonly #overall: number;
  readonly #typical: number;
  readonly #least: number;

  constructor(
    readonly elements: Elements,
    received: number,
  ) {
    const { sizes, places } = elements,
      count = sizes.length;
    this.#logs = Float64Array.from(sizes, (size) => Math.log(Math.max(size, SMALLEST)));
    this.#areas = this.#logs.map((log) => Math.exp(2 * log));
    this.#overall = gainFor(1 - received / count);
    this.#typical = this.#logs.slice().sort()[(count - 1) >> 1];
    this.#least = this.#logs.reduce((least, log) => Math.min(least, log), Infinity);
    const bySize = Int32Array.from({ length: count }, (_, i) => i).sort(
      (a, b) => sizes[b] - sizes[a] || places[a] - places[b],
    );
    this.#classes = CLASS_SHARES.map(
      (share) => new SizeClass(elements, bySize.slice(0, Math.max(Math.floor(count / share), MIN_CLASS))),
    );
  }

  /** Fills `out`, given the nearest others and the squares of their distances. */
  describe(i: number, near: Int32Array, far: Float64Array, out: Float64Array): void {
    const { known } = this.elements,
      { logs, active, unsure } = this.elements.anchors!(),
      areas = this.#areas,
      expected = this.#logs[i];
    const lengths = [0, 1, 2, 3].map((n) => Math.max(logs[4 * i + n], this.#least)),
      own = (lengths[1] + lengths[2] + lengths[3]) / 3;
    const close = near.subarray(0, CLOSE),
      end = close.length,
      own2 = Math.exp(2 * own);
    out[0] = this.#overall;
    COUNTS.forEach((count, n) => (out[1 + n] = gainFor(share(known, close.subarray(0, count)))));
    let at = 4;
    for (const reach of REACHES) {
      const { gone, whole } = this.#covered(i, close, far, reach);
      out[at++] = gainFor(gone / Math.max(whole, TINY));
      if (reach === MIDDLE_REACH) out[at++] = Math.log1p(gone / own2);
    }
    let all = 0,
      lost = 0,
      actives = 0,
      there = 0;
    for (const j of close) {
      all += areas[j];
      if (known[j]) {
        actives += active[j];
        there++;
      } else lost += areas[j];
    }
    out[at++] = gainFor(lost / Math.max(all, TINY));
    for (const members of this.#classes) {
      const { who, far } = members.near(i),
        { gone, whole } = this.#covered(i, who, far, MIDDLE_REACH);
      out[at++] = gainFor(share(known, who));
      out[at++] = gainFor(gone / Math.max(whole, TINY));
      out[at++] = Math.log1p(gone / own2);
    }
    const spacing = end ? distance(far[Math.min(SPACING_RANK, end - 1)]) : expected,
      farthest = end ? distance(far[end - 1]) : expected;
    out[at++] = own - spacing;
    out[at++] = lengths[0] - spacing;
    out[at++] = Math.max(lengths[1], lengths[2], lengths[3]) - own;
    out[at++] = expected - spacing;
    out[at++] = expected - this.#typical;
    out[at++] = farthest - spacing;
    out[at++] = Math.log(Math.max(active[i], FEWEST));
    out[at++] = Math.log(Math.max(actives / Math.max(there, 1), FEWEST));
    out[at++] = own - expected;
    out[at++] = unsure[2 * i];
    out[at++] = unsure[2 * i + 1];
  }

  /**
   * Areas of neighbours, less where they are far away for the sizes of both: of lost ones, and of all and the anchor
   * itself.
   */
  #covered(i: number, near: Int32Array, far: Float64Array, reach: number): { gone: number; whole: number } {
    const { known } = this.elements,
      areas = this.#areas;
    let gone = 0,
      whole = areas[i];
    for (let n = 0; n < near.length; n++) {
      const j = near[n],
        weight = areas[j] * Math.exp(-far[n] / (2 * (areas[j] + areas[i]) * reach));
      whole += weight;
      if (!known[j]) gone += weight;
    }
    return { gone, whole };
  }
}

const distance = (square: number): number => Math.log(Math.max(Math.sqrt(square), SMALLEST));

/** Share that is lost, counting heads. */
function share(known: Uint8Array, near: Int32Array): number {
  let lost = 0;
  for (const j of near) lost += known[j] ? 0 : 1;
  return lost / Math.max(near.length, 1);
}
