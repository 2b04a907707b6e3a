// Predicted positions, sizes and errors of anchors, received or lost, for the concealers.

import type { AnchorProperties, Elements } from "../../conceal/elements.ts";
import type { Anchors } from "../../model/anchors.ts";
import type { Pause } from "../../scheduler.ts";
import { receivedRanksFirst } from "../anchor_batch.ts";
import { CONCEALMENT_BYTES } from "../memory.ts";
import { exponential, featureSteps, worldPositions } from "./anchors.ts";
import type { PacketDecoder } from "./packet.ts";
import { predictedPosition } from "./positions.ts";
import { LOG_BITS, NUM_LOG_SCALINGS } from "./side_info.ts";
import { exactPower } from "./tables.ts";

const BATCH = 256,
  MIN_LENGTH = 1e-9,
  MIN_SHARE = 0.05,
  MIN_SPREAD = 1e-6;
/** Limits of binary logarithms of deviations, and of the relative errors of features and lengths. */
const LOG_DEVIATIONS = [-6, 13],
  FEATURE_ERRORS = [1e-3, 1e3],
  LENGTH_ERRORS = [1e-4, 1e3];

/** Anchors received in one packet. */
export interface ReceivedAnchors {
  readonly ranks: Int32Array;
  readonly anchors: Anchors;
  /** Sums of each feature channel and of its square. */
  readonly sums: Float64Array;
  readonly squares: Float64Array;
}

const clip = (value: number, [low, high]: readonly number[]): number => Math.min(Math.max(value, low), high);

export class AnchorPrediction {
  /**
   * Predicted voxel of each anchor relative to the corner, by rank. The first `#numPredicted` anchors are filled in.
   */
  #voxels = new Int32Array();
  /** Predicted logarithms of scale and sizes, and predicted log errors of features, scale and sizes. */
  #logs = new Float64Array();
  #logDeviations = new Int32Array();
  #numPredicted = 0;
  #sizes: Float32Array | null = null;

  /** `tierSizes` are the typical sizes of each anchor's tier, by rank; null if the stream does not contain them. */
  constructor(
    readonly packetDecoder: PacketDecoder,
    readonly count: number,
    readonly tierSizes: Float32Array | null,
  ) {}

  /** Returns the memory per anchor of this prediction and a concealer, bytes. */
  get bytes(): number {
    return CONCEALMENT_BYTES + 4 * 3 + 8 * NUM_LOG_SCALINGS + 4 * this.#width;
  }

  get #width(): number {
    return this.packetDecoder.info.features + NUM_LOG_SCALINGS;
  }

  /**
   * Returns the properties of all anchors: the received ones in this order, then the lost ones. All positions are
   * predicted ones. Resolves to null if the result is no longer needed.
   */
  async elements(received: readonly ReceivedAnchors[], pause: Pause): Promise<Elements | null> {
    const sizes = await this.#predictSizes(pause);
    if (!sizes) return null;
    const { ranks, numReceived } = receivedRanksFirst(received, this.count);
    let properties: AnchorProperties | null = null;
    const { tierSizes } = this;
    return {
      positions: this.positions(ranks),
      sizes: Float32Array.from(ranks, (rank) => sizes[rank]),
      tierSizes: tierSizes && Float32Array.from(ranks, (rank) => tierSizes[rank]),
      opacities: null,
      isReceived: new Uint8Array(this.count).fill(1, 0, numReceived),
      indices: ranks,
      logScales: null,
      anchors: () => (properties ??= this.#anchorProperties(received, ranks.subarray(0, numReceived))),
    };
  }

  #anchorProperties(received: readonly ReceivedAnchors[], ranks: Int32Array): AnchorProperties {
    const logs = new Float64Array(NUM_LOG_SCALINGS * ranks.length),
      numGaussians = new Uint8Array(ranks.length),
      expectedErrors = new Float64Array(2 * ranks.length);
    let at = 0;
    for (const {
      anchors: { count, numOffsets, scales, sizes, masks },
    } of received) {
      for (let n = 0; n < count; n++, at++) {
        logs[NUM_LOG_SCALINGS * at] = Math.log(scales[n]);
        for (let a = 0; a < 3; a++) logs[NUM_LOG_SCALINGS * at + 1 + a] = Math.log(sizes[3 * n + a]);
        for (let k = n * numOffsets; k < (n + 1) * numOffsets; k++) numGaussians[at] += masks[k];
      }
    }
    const shares = this.#stepWeights(received, ranks.length);
    ranks.forEach((rank, n) => {
      expectedErrors[2 * n] = Math.log(clip(this.#featureError(rank, shares), FEATURE_ERRORS));
      expectedErrors[2 * n + 1] = Math.log(clip(this.#lengthError(rank), LENGTH_ERRORS));
    });
    return { logs, numGaussians, expectedErrors };
  }

  /**
   * Returns the weight of a deviation of one step for each feature channel: the step relative to the channel's spread,
   * divided by the number of channels.
   */
  #stepWeights(received: readonly ReceivedAnchors[], count: number): Float64Array {
    const { info } = this.packetDecoder;
    return Float64Array.from(featureSteps(info), (step, c) => {
      const mean = received.reduce((sum, { sums }) => sum + sums[c], 0) / count,
        square = received.reduce((sum, { squares }) => sum + squares[c], 0) / count;
      return step / Math.max(Math.sqrt(Math.max(square - mean * mean, 0)), MIN_SPREAD) / info.features;
    });
  }

  /** Returns the expected error of a number in steps. */
  #expectedError(rank: number, column: number): number {
    return 2 ** clip(this.#logDeviations[rank * this.#width + column] / 65536, LOG_DEVIATIONS);
  }

  #featureError(rank: number, shares: Float64Array): number {
    return shares.reduce((sum, share, c) => sum + this.#expectedError(rank, c) * share, 0);
  }

  /** The scale counts for three lengths. */
  #lengthError(rank: number): number {
    const { info } = this.packetDecoder;
    let error = 0,
      total = 0;
    for (let a = 0; a < NUM_LOG_SCALINGS; a++) {
      const length = exponential(this.#logs[NUM_LOG_SCALINGS * rank + a]) * (a ? 1 : 3);
      error +=
        length * this.#expectedError(rank, info.features + a) * info.stepsOfLogs[a ? 1 : 0] * Math.LN2 * 2 ** -LOG_BITS;
      total += length;
    }
    return error / Math.max(total, 6 * MIN_LENGTH);
  }

  /**
   * Returns the predicted scale and sizes of all anchors, shape (count, 4), by rank. They are bit-identical on every
   * machine.
   */
  async lengths(pause: Pause): Promise<Float32Array | null> {
    return (
      (await this.#predictSizes(pause)) && new Float32Array(this.#logs.length).map((_, n) => exactPower(this.#logs[n]))
    );
  }

  /** Returns the predicted positions of some anchors, world units. */
  positions(ranks: Int32Array): Float32Array {
    return worldPositions(
      Int32Array.from({ length: 3 * ranks.length }, (_, n) => this.#voxels[3 * ranks[Math.floor(n / 3)] + (n % 3)]),
      this.packetDecoder.info,
    );
  }

  /** Returns the geometric means of the predicted sizes of all anchors, by rank. Computes them once, in batches. */
  async #predictSizes(pause: Pause): Promise<Float32Array | null> {
    if (this.#logs.length < NUM_LOG_SCALINGS * this.count) {
      this.#voxels = new Int32Array(3 * this.count);
      this.#logs = new Float64Array(NUM_LOG_SCALINGS * this.count);
      this.#logDeviations = new Int32Array(this.#width * this.count);
    }
    while (this.#numPredicted < this.count) {
      if (!(await pause())) return null;
      this.#predictBatch(this.#numPredicted, Math.min(this.#numPredicted + BATCH, this.count));
    }
    return (this.#sizes ??= meanSizes(this.#logs));
  }

  #predictBatch(first: number, end: number): void {
    for (let rank = first; rank < end; rank++)
      this.#voxels.set(predictedPosition(this.packetDecoder.info.positions, rank), 3 * rank);
    const { logs, logDeviations } = this.packetDecoder.predicted(this.#voxels.subarray(3 * first, 3 * end));
    this.#logs.set(logs, NUM_LOG_SCALINGS * first);
    this.#logDeviations.set(logDeviations, this.#width * first);
    this.#numPredicted = end;
  }
}

/**
 * Computes the geometric means of the sizes. Predictions may be far off, so each size is at least a share of the
 * median.
 */
function meanSizes(logs: Float64Array): Float32Array {
  const sizes = new Float32Array((3 * logs.length) / NUM_LOG_SCALINGS).map(
    (_, n) => 2 ** (logs[NUM_LOG_SCALINGS * Math.floor(n / 3) + 1 + (n % 3)] / 2 ** LOG_BITS),
  );
  const typical = sizes.slice().sort()[(sizes.length - 1) >> 1] ?? 0,
    least = Math.max(MIN_SHARE * typical, MIN_LENGTH);
  const log = (at: number): number => Math.log(Math.max(sizes[at], least));
  return Float32Array.from({ length: sizes.length / 3 }, (_, n) =>
    Math.exp((log(3 * n) + log(3 * n + 1) + log(3 * n + 2)) / 3),
  );
}
