// Conversion of decoded integers to anchors and heads. It is the last step and the only floating-point part of the
// codec.

import type { Affine } from "../../model/affine.ts";
import type { Anchors } from "../../model/anchors.ts";
import type { Mlp } from "../../model/heads.ts";
import { BIAS_BITS, WEIGHT_BITS } from "../integer_network.ts";
import type { QuantisedLinear, QuantisedMlp } from "../weight_bytes.ts";
import { type Decoded, logOf } from "./packet.ts";
import { LOG_BITS, NUM_LOG_SCALINGS, type SideInfo } from "./side_info.ts";

const VALUE_ONE = 2 ** 16,
  LOG = 2 ** LOG_BITS,
  MAX_LOG = 60,
  SLOPE = 0.01;

/** Returns the anchors and their feature vectors, shape (count, features). */
export function toAnchors(
  { count, voxels, masks, values }: Decoded,
  info: SideInfo,
): { anchors: Anchors; features: Float32Array } {
  const { features: size, offsets: numOffsets, groups, linearSteps } = info,
    width = size + NUM_LOG_SCALINGS + 3 * numOffsets;
  const units = featureSteps(info).map((step) => step / VALUE_ONE),
    step = linearSteps[groups.length] / VALUE_ONE;
  const scales = new Float32Array(count),
    sizes = new Float32Array(3 * count);
  const features = new Float32Array(size * count),
    offsets = new Float32Array(3 * numOffsets * count);
  for (let n = 0; n < count; n++) {
    const row = n * width,
      first = row + size;
    for (let c = 0; c < size; c++) features[n * size + c] = values[row + c] * units[c];
    scales[n] = exponential(logOf(info, values[first], 0));
    for (let a = 0; a < 3; a++) sizes[3 * n + a] = exponential(logOf(info, values[first + 1 + a], 1 + a));
    for (let c = 0; c < 3 * numOffsets; c++)
      offsets[3 * numOffsets * n + c] = values[first + NUM_LOG_SCALINGS + c] * step;
  }
  return {
    anchors: { count, numOffsets, positions: worldPositions(voxels, info), scales, sizes, masks, offsets },
    features,
  };
}

/** Returns the quantisation step of each feature channel. */
export function featureSteps({ groups, linearSteps }: SideInfo): number[] {
  return groups.flatMap((channels, g) => Array.from({ length: channels }, () => linearSteps[g]));
}

/** Converts voxel indices relative to the corner to world coordinates, shape (count, 3). */
export function worldPositions(voxels: Int32Array, { positions: { corner }, voxelSize }: SideInfo): Float32Array {
  return Float32Array.from(voxels, (voxel, at) => (voxel + corner[at % 3]) * voxelSize);
}

/** Returns two to the power of `log`, which has 24 fractional bits. */
export function exponential(log: number): number {
  return 2 ** Math.min(Math.max(log / LOG, -MAX_LOG), MAX_LOG);
}

/** Converts a quantised network to floating point. */
export function floatMlp({ hidden, output, leaky }: QuantisedMlp): Mlp {
  return { hidden: affine(hidden), output: affine(output), slope: leaky ? SLOPE : 0 };
}

function affine({ inputs, outputs, symbols, rowSteps, columnShifts, bias }: QuantisedLinear): Affine {
  const weights = symbols.map(
    (symbol, at) => (symbol * rowSteps[Math.floor(at / inputs)] * 2 ** columnShifts[at % inputs]) / 2 ** WEIGHT_BITS,
  );
  return { inputs, outputs, weights, bias: bias.map((value) => value / 2 ** BIAS_BITS) };
}
