// Neural networks in integer arithmetic, carried by doubles, with bit-identical results on every machine. Counterpart
// of `splatwire.codec.integer_network`.

import { BitstreamError } from "../bytes.ts";
import { type Affine, affine, padded } from "../model/affine.ts";
import type { QuantisedLinear, QuantisedMlp } from "./weight_bytes.ts";

/** Fractional bits of inputs and hidden units, outputs, weights, and biases. */
export const ACTIVATION_BITS = 14,
  OUTPUT_BITS = 16,
  WEIGHT_BITS = 16,
  BIAS_BITS = 12;
/** Limits of hidden units and outputs, both 1024 in real units. They keep every partial sum below `EXACT`. */
export const ACTIVATION_LIMIT = 2 ** 24,
  OUTPUT_LIMIT = 2 ** 26,
  EXACT = 2 ** 52;
/** Slope of the leaky rectifier below zero. */
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

/** Network of two layers with a rectifier, leaky or not, in between. */
export class IntegerMlp {
  /** Number of outputs per row, rounded up to an even number. */
  readonly outputs: number;
  readonly #hidden: Affine;
  readonly #output: Affine;
  readonly #leak: number;
  #between = new Float64Array();

  constructor(network: QuantisedMlp) {
    this.#hidden = layer(network.hidden);
    // Hidden units added to reach an even number have weight 0.
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
   * Evaluates the network. Input rows are integers with 14 fractional bits and begin `stride` apart; `rows` is a
   * multiple of `ROWS`. Writes outputs with 16 fractional bits to `out`, shape (rows, outputs).
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
