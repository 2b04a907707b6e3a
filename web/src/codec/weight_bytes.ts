// Quantised neural networks. Each array is coded under a normal distribution fitted to it. Counterpart of
// `splatwire.codec.weight_bytes`.

import { BitstreamError, type ByteReader } from "../bytes.ts";
import { RangeDecoder } from "../entropy/decoder.ts";
import { readIntegers } from "../entropy/integers.ts";
import { zeroMeanNormal } from "../entropy/mixture.ts";
import { NUM_SCALES } from "../entropy/tables.ts";
import { MAX_SHIFT, MAX_STEP, MAX_SYMBOL, MAX_WEIGHTS, MAX_WIDTH } from "./network_limits.ts";

const LEAKY = 1,
  WITH_COLUMN_SCALES = 2;

/**
 * Affine layer. Weight (row o, column i) is `symbols[o inputs + i] * rowSteps[o] << columnShifts[i]`, out of 2^16.
 * Biases are out of 2^12.
 */
export interface QuantisedLinear {
  readonly inputs: number;
  readonly outputs: number;
  readonly symbols: Float64Array;
  readonly rowSteps: Float64Array;
  readonly columnShifts: Float64Array;
  readonly bias: Float64Array;
}

export interface QuantisedMlp {
  readonly hidden: QuantisedLinear;
  readonly output: QuantisedLinear;
  /** True for a leaky rectifier with slope 0.01 below zero, false for slope 0. */
  readonly leaky: boolean;
}

/** Reads networks with the given names, inputs and outputs. The names appear in error messages. */
export function readNetworks(
  reader: ByteReader,
  shapes: readonly (readonly [string, number, number])[],
): QuantisedMlp[] {
  let left = MAX_WEIGHTS;
  const found = shapes.map(([subject, inputs, outputs]) => {
    const network = readMlp(reader, subject, inputs, outputs, left);
    left -= (inputs + outputs) * network.hidden.outputs;
    return network;
  });
  reader.finish();
  return found;
}

function readMlp(reader: ByteReader, subject: string, inputs: number, outputs: number, most: number): QuantisedMlp {
  const shape = [reader.unsigned(), reader.unsigned(), reader.unsigned()],
    flags = reader.u8(),
    hidden = shape[1];
  const fail = (text: string): never => {
    throw new BitstreamError(`${subject} network: ${text}`);
  };
  if (flags > (LEAKY | WITH_COLUMN_SCALES)) fail(`flags ${flags} are unknown`);
  if (shape[0] !== inputs || shape[2] !== outputs || hidden < 1 || hidden > MAX_WIDTH)
    fail(`shape ${shape} where ${inputs} inputs and ${outputs} outputs are needed`);
  if ((inputs + outputs) * hidden > most) fail(`${shape} is too large`);
  const columns = (flags & WITH_COLUMN_SCALES) !== 0,
    first = readLinear(reader, fail, inputs, hidden, columns);
  return { hidden: first, output: readLinear(reader, fail, hidden, outputs, columns), leaky: (flags & LEAKY) !== 0 };
}

function readLinear(
  reader: ByteReader,
  fail: (text: string) => never,
  inputs: number,
  outputs: number,
  columns: boolean,
): QuantisedLinear {
  const between = (name: string, values: Float64Array, low: number, high: number): Float64Array =>
    values.every((value) => value >= low && value <= high)
      ? values
      : fail(`a ${name} is not between ${low} and ${high}`);
  const rowSteps = between("row step", readIntegers(reader, outputs), 1, MAX_STEP);
  const columnShifts = between("column shift", readIntegers(reader, inputs), 0, MAX_SHIFT);
  const bias = between("bias", readIntegers(reader, outputs), -MAX_SYMBOL, MAX_SYMBOL);
  const scales = between("row scale", readIntegers(reader, outputs), 0, NUM_SCALES - 1);
  const further = columns
    ? between("column scale", readIntegers(reader, inputs), -NUM_SCALES, NUM_SCALES)
    : new Float64Array(inputs);
  const coder = new RangeDecoder(reader.blob()),
    symbols = new Float64Array(inputs * outputs);
  for (let o = 0, at = 0; o < outputs; o++) {
    for (let i = 0; i < inputs; i++)
      symbols[at++] = zeroMeanNormal(Math.min(Math.max(scales[o] + further[i], 0), NUM_SCALES - 1)).decode(coder);
  }
  return {
    inputs,
    outputs,
    symbols: between("weight", symbols, -MAX_SYMBOL, MAX_SYMBOL),
    rowSteps,
    columnShifts,
    bias,
  };
}
