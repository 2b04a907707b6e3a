// Packet decoder for anchors. Each number of an anchor is predicted from its position and its earlier numbers. Any
// bytes decode to some anchors.

import { RangeDecoder } from "../../entropy/decoder.ts";
import { zeroMeanNormal } from "../../entropy/mixture.ts";
import { ROWS } from "../../model/affine.ts";
import { ACTIVATION_BITS, ACTIVATION_LIMIT, IntegerMlp } from "../integer_network.ts";
import { decodePositions } from "./positions.ts";
import { NUM_LOG_SCALINGS, OCTAVES, type SideInfo, type Stage } from "./side_info.ts";
import { existsOf, scaleOf } from "./tables.ts";

const ONE = 2 ** ACTIVATION_BITS,
  FULL = 65536,
  LARGEST_SYMBOL = 15360;

/** Decoded integers of some anchors. */
export interface Decoded {
  readonly count: number;
  /** Voxels relative to the corner, shape (count, 3). */
  readonly voxels: Int32Array;
  /** Existing offsets (1) of each anchor, shape (count, offsets). */
  readonly masks: Uint8Array;
  /** Values in steps with 16 fractional bits: features, four logarithms, offsets. Missing offsets are 0. */
  readonly values: Int32Array;
}

/**
 * Predicted logarithms of scale and sizes (24 fractional bits), shape (count, 4). `logDeviations` are the binary
 * logarithms of the expected errors of features, scale and sizes in steps (16 fractional bits).
 */
export interface PredictedValues {
  readonly logs: Float64Array;
  readonly logDeviations: Int32Array;
}

/** Decodes the packets of one stream. */
export class PacketDecoder {
  readonly #position: IntegerMlp;
  readonly #networks: readonly IntegerMlp[];
  /** Values per anchor. */
  readonly width: number;
  /** Network inputs per anchor: the context from its position, then its decoded values. */
  readonly #stride: number;
  #inputs = new Float64Array();
  #positionInputs = new Float64Array();
  #outputs = new Float64Array();

  constructor(readonly info: SideInfo) {
    this.#position = new IntegerMlp(info.position);
    this.#networks = info.networks.map((network) => new IntegerMlp(network));
    const last = info.stages[info.stages.length - 1];
    this.width = last.first + last.size;
    this.#stride = info.context + last.first;
  }

  /** Decodes a packet. `ranks` are the ranks of its anchors, in packet order. */
  decode(payload: Uint8Array, ranks: Int32Array): Decoded {
    const { info } = this,
      count = ranks.length,
      coder = new RangeDecoder(payload),
      last = info.stages[info.stages.length - 1];
    const masks = new Uint8Array(count * info.offsets),
      values = new Int32Array(count * this.width);
    const voxels = decodePositions(coder, info.positions, ranks);
    this.#computeContext(voxels, count);
    for (const [s, stage] of info.stages.entries()) {
      const outputs = this.#predict(s, count),
        width = this.#networks[s].outputs;
      if (stage.numMaskLogits) readMasks(coder, outputs, width, stage.numMaskLogits, masks);
      this.#read(coder, stage, outputs, width, stage === last ? masks : null, values);
      if (stage !== last) this.#appendInputs(stage, values, count);
    }
    return { count, voxels, masks, values };
  }

  /** Predicts the values, without offsets, of anchors with known or predicted positions. */
  predicted(voxels: Int32Array): PredictedValues {
    const { info } = this,
      count = voxels.length / 3,
      values = new Int32Array(count * this.width),
      logs = new Float64Array(NUM_LOG_SCALINGS * count);
    const known = info.features + NUM_LOG_SCALINGS,
      logDeviations = new Int32Array(known * count);
    this.#computeContext(voxels, count);
    for (const [s, stage] of info.stages.slice(0, -1).entries()) {
      const outputs = this.#predict(s, count),
        width = this.#networks[s].outputs,
        { first, size, numMaskLogits } = stage;
      for (let n = 0, row = numMaskLogits; n < count; n++, row += width) {
        for (let c = 0; c < size; c++) {
          values[n * this.width + first + c] = outputs[row + c];
          logDeviations[n * known + first + c] = outputs[row + size + c];
        }
      }
      this.#appendInputs(stage, values, count);
    }
    for (let n = 0; n < count; n++)
      for (let a = 0; a < NUM_LOG_SCALINGS; a++)
        logs[NUM_LOG_SCALINGS * n + a] = logOf(info, values[n * this.width + info.features + a], a);
    return { logs, logDeviations };
  }

  /** Evaluates the position network, which gives each anchor's context. */
  #computeContext(voxels: Int32Array, count: number): void {
    const rows = Math.ceil(count / ROWS) * ROWS,
      inputs = 3 * (1 + OCTAVES),
      {
        context,
        middle,
        spread,
        positions: { corner },
      } = this.info;
    const widest = Math.max(this.#position.outputs, ...this.#networks.map((network) => network.outputs));
    if (this.#inputs.length < rows * this.#stride) this.#inputs = new Float64Array(rows * this.#stride);
    if (this.#positionInputs.length < rows * inputs) this.#positionInputs = new Float64Array(rows * inputs);
    if (this.#outputs.length < rows * widest) this.#outputs = new Float64Array(rows * widest);
    for (let n = 0; n < count; n++) {
      for (let a = 0; a < 3; a++) {
        const u = contracted(voxels[3 * n + a] + corner[a] - middle[a], spread[a]),
          at = n * inputs + a;
        this.#positionInputs[at] = u;
        for (let octave = 1; octave <= OCTAVES; octave++) {
          this.#positionInputs[at + 3 * octave] = Math.abs((((u << octave) - ONE) & (4 * ONE - 1)) - 2 * ONE) - ONE;
        }
      }
    }
    this.#position.run(this.#positionInputs, inputs, rows, this.#outputs);
    const width = this.#position.outputs;
    for (let n = 0; n < count; n++) {
      for (let c = 0; c < context; c++) this.#inputs[n * this.#stride + c] = this.#outputs[n * width + c] >> 2;
    }
  }

  #predict(stage: number, count: number): Float64Array {
    this.#networks[stage].run(this.#inputs, this.#stride, Math.ceil(count / ROWS) * ROWS, this.#outputs);
    return this.#outputs;
  }

  /** Decodes the values of a stage as predicted mean plus whole steps. Offsets that do not exist are skipped. */
  #read(
    coder: RangeDecoder,
    stage: Stage,
    outputs: Float64Array,
    width: number,
    exists: Uint8Array | null,
    values: Int32Array,
  ): void {
    const { first, size, numMaskLogits } = stage;
    for (
      let at = first, row = numMaskLogits, mask = 0;
      at < values.length;
      at += this.width, row += width, mask += size / 3
    ) {
      for (let c = 0; c < size; c++) {
        if (exists && !exists[mask + Math.floor(c / 3)]) continue;
        const symbol = zeroMeanNormal(scaleOf(outputs[row + size + c])).decode(coder);
        values[at + c] = outputs[row + c] + Math.min(Math.max(symbol, -LARGEST_SYMBOL), LARGEST_SYMBOL) * FULL;
      }
    }
  }

  /** Appends the values of a stage to the inputs of the next ones. One step is an input of 0.25. */
  #appendInputs({ first, size }: Stage, values: Int32Array, count: number): void {
    for (let n = 0; n < count; n++) {
      for (let c = 0, from = n * this.width + first, to = n * this.#stride + this.info.context + first; c < size; c++) {
        this.#inputs[to + c] = Math.min(Math.max(values[from + c] >> 4, -ACTIVATION_LIMIT), ACTIVATION_LIMIT);
      }
    }
  }
}

/** Returns the binary logarithm of a scale (index 0) or size (indices 1 to 3), 24 fractional bits. */
export function logOf({ stepsOfLogs, zeroPoints }: SideInfo, number: number, index: number): number {
  return Math.floor((number * stepsOfLogs[index ? 1 : 0]) / FULL) + zeroPoints[index];
}

function readMasks(
  coder: RangeDecoder,
  outputs: Float64Array,
  width: number,
  numOffsets: number,
  masks: Uint8Array,
): void {
  for (let at = 0, row = 0; at < masks.length; row += width) {
    for (let k = 0; k < numOffsets; k++, at++) {
      const probability = existsOf(outputs[row + k]);
      masks[at] = coder.target(FULL) < probability ? 1 : 0;
      if (masks[at]) coder.advance(0, probability, FULL);
      else coder.advance(probability, FULL - probability, FULL);
    }
  }
}

/** Maps a distance, in units of `spread`, to (-1, 1). The result has 14 fractional bits. */
function contracted(away: number, spread: number): number {
  const relative = quotient(away, spread);
  return quotient(relative, ONE + Math.abs(relative));
}

/** Returns the quotient with 14 fractional bits, rounded down. It is exact for operands of at most 41 bits. */
function quotient(a: number, b: number): number {
  let whole = Math.floor(a / b),
    rest = a - whole * b;
  for (let n = 0; n < 2; n++) {
    const part = Math.floor((rest * 128) / b);
    whole = whole * 128 + part;
    rest = rest * 128 - part * b;
  }
  return whole;
}
