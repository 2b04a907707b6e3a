// Where anchors are expected, and how large, and how sure that is: what a concealer needs of them.

import type { AnchorFacts, Elements } from "../../conceal/elements.ts";
import type { Anchors } from "../../model/anchors.ts";
import type { Pause } from "../../turns.ts";
import { givenFirst } from "../anchor_part.ts";
import { LOOKED_AT_BYTES } from "../memory.ts";
import { exponential, featureSteps, worldPlaces } from "./anchors.ts";
import type { PacketDecoder } from "./packet.ts";
import { expectedPlace } from "./positions.ts";
import { FORM, LOG_BITS } from "./side_info.ts";
import { exactPower } from "./tables.ts";

const AT_A_TIME = 256,
  SMALLEST = 1e-9,
  LEAST_SHARE = 0.05,
  LEAST_SPREAD = 1e-6;
/** Limits of binary logarithms of deviations, and of what is told of them: of features and of lengths. */
const LOG_DEVIATIONS = [-6, 13],
  FEATURES = [1e-3, 1e3],
  LENGTHS = [1e-4, 1e3];

/** Anchors that arrived together. */
export interface Arrived {
  readonly ranks: Int32Array;
  readonly anchors: Anchors;
  /** Sums of each feature, and of its square. */
  readonly sums: Float64Array;
  readonly squares: Float64Array;
}

const clip = (value: number, [low, high]: readonly number[]): number => Math.min(Math.max(value, low), high);

export class Expected {
  /** Where each anchor is expected, voxels from the origin, by rank; the first so many are known by now. */
  #places = new Int32Array();
  /** Logarithms of the scale and the three sizes that are expected there, and of how far features and those are off. */
  #logs = new Float64Array();
  #spreads = new Int32Array();
  #done = 0;
  #sizes: Float32Array | null = null;

  /** `tierSizes` are those of each anchor's tier, by rank; null where the sender does not say. */
  constructor(
    readonly packets: PacketDecoder,
    readonly count: number,
    readonly tierSizes: Float32Array | null,
  ) {}

  /** Memory that this and a concealer take for an anchor, once somebody asks. */
  get bytes(): number {
    return LOOKED_AT_BYTES + 4 * 3 + 8 * FORM + 4 * this.#width;
  }

  get #width(): number {
    return this.packets.info.features + FORM;
  }

  /**
   * First the received anchors, in this order, then the lost ones; null where nobody waits any more. All lie where they
   * are expected.
   */
  async elements(received: readonly Arrived[], pause: Pause): Promise<Elements | null> {
    const sizes = await this.#expectedSizes(pause);
    if (!sizes) return null;
    const { ranks, end } = givenFirst(received, this.count);
    let facts: AnchorFacts | null = null;
    const { tierSizes } = this;
    return {
      positions: this.positions(ranks),
      sizes: Float32Array.from(ranks, (rank) => sizes[rank]),
      tierSizes: tierSizes && Float32Array.from(ranks, (rank) => tierSizes[rank]),
      opacities: null,
      known: new Uint8Array(this.count).fill(1, 0, end),
      places: ranks,
      logScales: null,
      anchors: () => (facts ??= this.#facts(received, ranks.subarray(0, end))),
    };
  }

  #facts(received: readonly Arrived[], ranks: Int32Array): AnchorFacts {
    const logs = new Float64Array(FORM * ranks.length),
      active = new Uint8Array(ranks.length),
      unsure = new Float64Array(2 * ranks.length);
    let at = 0;
    for (const {
      anchors: { count, numOffsets, scales, sizes, masks },
    } of received) {
      for (let n = 0; n < count; n++, at++) {
        logs[FORM * at] = Math.log(scales[n]);
        for (let a = 0; a < 3; a++) logs[FORM * at + 1 + a] = Math.log(sizes[3 * n + a]);
        for (let k = n * numOffsets; k < (n + 1) * numOffsets; k++) active[at] += masks[k];
      }
    }
    const shares = this.#shares(received, ranks.length);
    ranks.forEach((rank, n) => {
      unsure[2 * n] = Math.log(clip(this.#featureDoubt(rank, shares), FEATURES));
      unsure[2 * n + 1] = Math.log(clip(this.#lengthDoubt(rank), LENGTHS));
    });
    return { logs, active, unsure };
  }

  /**
   * What a deviation of one step of each feature counts: its share of the feature's spread among what arrived, out of
   * all features.
   */
  #shares(received: readonly Arrived[], count: number): Float64Array {
    const { info } = this.packets;
    return Float64Array.from(featureSteps(info), (step, c) => {
      const mean = received.reduce((sum, { sums }) => sum + sums[c], 0) / count,
        square = received.reduce((sum, { squares }) => sum + squares[c], 0) / count;
      return step / Math.max(Math.sqrt(Math.max(square - mean * mean, 0)), LEAST_SPREAD) / info.features;
    });
  }

  /** Steps by which a number is expected to be off. */
  #deviation(rank: number, column: number): number {
    return 2 ** clip(this.#spreads[rank * this.#width + column] / 65536, LOG_DEVIATIONS);
  }

  #featureDoubt(rank: number, shares: Float64Array): number {
    return shares.reduce((sum, share, c) => sum + this.#deviation(rank, c) * share, 0);
  }

  /** The scale stands for three lengths. */
  #lengthDoubt(rank: number): number {
    const { info } = this.packets;
    let off = 0,
      all = 0;
    for (let a = 0; a < FORM; a++) {
      const length = exponential(this.#logs[FORM * rank + a]) * (a ? 1 : 3);
      off += length * this.#deviation(rank, info.features + a) * info.logSteps[a ? 1 : 0] * Math.LN2 * 2 ** -LOG_BITS;
      all += length;
    }
    return off / Math.max(all, 6 * SMALLEST);
  }

  /** The expected unit of offsets and sizes of each anchor, by rank: alike on every machine. */
  async lengths(pause: Pause): Promise<Float32Array | null> {
    return (
      (await this.#expectedSizes(pause)) && new Float32Array(this.#logs.length).map((_, n) => exactPower(this.#logs[n]))
    );
  }

  /** Where anchors are expected, world units. */
  positions(ranks: Int32Array): Float32Array {
    return worldPlaces(
      Int32Array.from({ length: 3 * ranks.length }, (_, n) => this.#places[3 * ranks[Math.floor(n / 3)] + (n % 3)]),
      this.packets.info,
    );
  }

  /** Geometric means of the sizes that are expected of all anchors, by rank: worked out once, a little at a time. */
  async #expectedSizes(pause: Pause): Promise<Float32Array | null> {
    if (this.#logs.length < FORM * this.count) {
      this.#places = new Int32Array(3 * this.count);
      this.#logs = new Float64Array(FORM * this.count);
      this.#spreads = new Int32Array(this.#width * this.count);
    }
    while (this.#done < this.count) {
      if (!(await pause())) return null;
      this.#expectSome(this.#done, Math.min(this.#done + AT_A_TIME, this.count));
    }
    return (this.#sizes ??= meanSizes(this.#logs));
  }

  #expectSome(first: number, end: number): void {
    for (let rank = first; rank < end; rank++)
      this.#places.set(expectedPlace(this.packets.info.positions, rank), 3 * rank);
    const { logs, spreads } = this.packets.expected(this.#places.subarray(3 * first, 3 * end));
    this.#logs.set(logs, FORM * first);
    this.#spreads.set(spreads, this.#width * first);
    this.#done = end;
  }
}

/** A prediction may be far off: none is below a share of their median. */
function meanSizes(logs: Float64Array): Float32Array {
  const sizes = new Float32Array((3 * logs.length) / FORM).map(
    (_, n) => 2 ** (logs[FORM * Math.floor(n / 3) + 1 + (n % 3)] / 2 ** LOG_BITS),
  );
  const typical = sizes.slice().sort()[(sizes.length - 1) >> 1] ?? 0,
    least = Math.max(LEAST_SHARE * typical, SMALLEST);
  const log = (at: number): number => Math.log(Math.max(sizes[at], least));
  return Float32Array.from({ length: sizes.length / 3 }, (_, n) =>
    Math.exp((log(3 * n) + log(3 * n + 1) + log(3 * n + 2)) / 3),
  );
}
