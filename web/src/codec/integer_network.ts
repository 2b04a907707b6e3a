// Networks evaluated in integers, which doubles carry: bit-identical on any machine. The twin of
// `splatwire.codec.integer_network`.

import { BitstreamError } from "../bytes.ts";
import { type Affine, affine, padded } from "../model/affine.ts";
import type { QuantisedLinear, QuantisedMlp } from "./weight_bytes.ts";

/** Fractional bits: inputs and hidden units, outputs, weights, biases. */
export const ACTIVATION_BITS = 14,
  OUTPUT_BITS = 16,
  WEIGHT_BITS = 16,
  BIAS_BITS = 12;
/** Limits of activations and outputs, 1024 units; with them every partial sum stays below `EXACT`. */
export const ACTIVATION_LIMIT = 2 ** 24,
  OUTPUT_LIMIT = 2 ** 26,
  EXACT = 2 ** 52;
/** Slope below zero, where there is one. */
const LEAK = 655 / 65536;
function layer({ inputs, outputs, symbols, rowSteps, columnShifts, bias }: QuantisedLinear): Affine {
  const weights = new Float64Array(outputs * inputs),
    biases = new Float64Array(outputs);
  for (let o = 0; o < outputs; o++) {
    let largest = 0;
    for (let i = 0; i < inputs; i++) {
      const weight = symbols[o * inputs + i] * rowSteps[o] * 2 ** columnShifts[i];
      weights[o * inputs + i] = weight;
      largest += Math.abs(weight);
    }
    biases[o] = bias[o] * 2 ** (ACTIVATION_BITS + WEIGHT_BITS - BIAS_BITS);
    if (largest * ACTIVATION_LIMIT + Math.abs(biases[o]) >= EXACT)
      throw new BitstreamError("network weights are too large to be evaluated exactly");
  }
  return padded({ inputs, outputs, weights, bias: biases });
}

/** Two layers with a (leaky) rectifier between them. */
export class IntegerMlp {
  /** Outputs of a row: one more than the network has where that is an odd number. */
  readonly outputs: number;
  readonly #hidden: Affine;
  readonly #output: Affine;
  readonly #leak: number;
  #between = new Float64Array();

  constructor(network: QuantisedMlp) {
    this.#hidden = layer(network.hidden);
    // Hidden units that only fill up an even number are inputs of weight 0.
    const { outputs, inputs, symbols, columnShifts } = network.output,
      width = this.#hidden.outputs;
    const wide = new Float64Array(outputs * width),
      shifts = new Float64Array(width);
    for (let o = 0; o < outputs; o++) wide.set(symbols.subarray(o * inputs, (o + 1) * inputs), o * width);
    shifts.set(columnShifts);
    this.#output = layer({ ...network.output, inputs: width, symbols: wide, columnShifts: shifts });
    this.outputs = this.#output.outputs;
    this.#leak = network.leaky ? LEAK : 0;
  }

  /**
   * Evaluates rows of inputs that lie `stride` apart (whole numbers, 14 fractional bits); `rows` is a multiple of
   * `ROWS`. Outputs (16 fractional bits) lie `outputs` apart in `out`.
   */
  run(inputs: Float64Array, stride: number, rows: number, out: Float64Array): void {
    const width = this.#hidden.outputs,
      size = rows * width;
    if (this.#between.length < size) this.#between = new Float64Array(size);
    const hidden = this.#between,
      leak = this.#leak;
    affine(this.#hidden, inputs, stride, rows, hidden);
    for (let i = 0; i < size; i++) {
      const value = Math.floor(hidden[i] / 65536);
      hidden[i] = Math.min(Math.max(value > 0 ? value : Math.floor(value * leak), -ACTIVATION_LIMIT), ACTIVATION_LIMIT);
    }
    affine(this.#output, hidden, width, rows, out);
    for (let i = 0, end = rows * this.outputs; i < end; i++)
      out[i] = Math.min(Math.max(Math.floor(out[i] / 16384), -OUTPUT_LIMIT), OUTPUT_LIMIT);
  }
}
