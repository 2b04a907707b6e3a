// Side information of a stream of the causal codec. Counterpart of `splatwire.codec.anchors.causal.side_info`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import {
  MAX_CAUSAL_CONTEXT,
  MAX_CAUSAL_FEATURES,
  MAX_CAUSAL_GROUPS,
  MAX_CAUSAL_OFFSETS,
  MAX_CAUSAL_STEP_OF_LOGS,
  MAX_CAUSAL_ZERO_POINT,
  MAX_CENTRE_DISTANCE,
  MAX_COORD,
} from "../../packets/limits.ts";
import { readSections } from "../../packets/sections.ts";
import { type QuantisedMlp, readNetworks } from "../weight_bytes.ts";
import { type Positions, readPositions } from "./positions.ts";

export const LOG_BITS = 24,
  OCTAVES = 4,
  NUM_LOG_SCALINGS = 4;
const VERSION = 2;
const HEADS = ["opacity", "covariance", "color"];

/** Dimensions and quantisation of an anchor. */
export interface Header {
  readonly groups: readonly number[];
  readonly features: number;
  readonly offsets: number;
  /** Numbers of the context derived from an anchor's position. */
  readonly context: number;
  /** Quantisation steps of the feature groups, then of the offsets. */
  readonly linearSteps: readonly number[];
  readonly voxelSize: number;
  /** Steps of the binary logarithms of offset scale and sizes, and their zero points; 24 fractional bits. */
  readonly stepsOfLogs: readonly number[];
  readonly zeroPoints: readonly number[];
  /** `CausalCoding.middle` and `CausalCoding.spread` of Python, voxels. */
  readonly middle: readonly number[];
  readonly spread: readonly number[];
}

/**
 * Numbers of an anchor that are predicted together. A network's outputs are the logits of `numMaskLogits` masks, then
 * means and binary logarithms of standard deviations.
 */
export interface Stage {
  readonly name: string;
  /** Index of the first number among the anchor's numbers. */
  readonly first: number;
  readonly size: number;
  readonly numMaskLogits: number;
}

export interface SideInfo extends Header {
  readonly positions: Positions;
  readonly position: QuantisedMlp;
  readonly stages: readonly Stage[];
  /** One network per stage. */
  readonly networks: readonly QuantisedMlp[];
  /** Heads for opacity, covariance and colour. */
  readonly heads: readonly QuantisedMlp[];
  readonly sections: Map<string, Uint8Array>;
}

export function readSideInfo(bytes: Uint8Array, count: number): SideInfo {
  const reader = new ByteReader(bytes, "side information");
  const header = readHeader(reader.blob()),
    positions = readPositions(reader.blob(), count),
    networks = new ByteReader(reader.blob(), "networks");
  const render = new ByteReader(reader.blob(), "render networks"),
    sections = readSections(reader.rest());
  const { features, offsets, context } = header,
    stages = stagesOf(header);
  const [position, ...found] = readNetworks(networks, [
    ["position", 3 * (1 + OCTAVES), context],
    ...stages.map(({ name, first, size, numMaskLogits }) => [name, context + first, numMaskLogits + 2 * size] as const),
  ]);
  const heads = readNetworks(
    render,
    [1, 7, 3].map((each, n) => [HEADS[n], features + 4, offsets * each] as const),
  );
  checkFar(header, positions);
  return { ...header, positions, position, stages, networks: found, heads, sections };
}

/** Throws if anchors are too far from the centre, where relative positions would no longer be exact in doubles. */
function checkFar({ middle, spread }: Header, { corner }: Positions): void {
  const far = middle.some((value, a) => Math.abs(corner[a] - value) > MAX_CENTRE_DISTANCE * spread[a]);
  if (far) throw new BitstreamError("side information: its anchors are too far away from the scene's middle");
}

/** Returns the stages in coding order: feature groups, existing offsets with the scale, sizes, offsets. */
function stagesOf({ groups, features, offsets }: Header): Stage[] {
  const stages: Stage[] = [];
  let first = 0;
  for (const [g, size] of groups.entries()) {
    stages.push({ name: `feature${g}`, first, size, numMaskLogits: 0 });
    first += size;
  }
  return [
    ...stages,
    { name: "form", first: features, size: 1, numMaskLogits: offsets },
    { name: "size", first: features + 1, size: 3, numMaskLogits: 0 },
    { name: "offset", first: features + NUM_LOG_SCALINGS, size: 3 * offsets, numMaskLogits: 0 },
  ];
}

function readHeader(bytes: Uint8Array): Header {
  const reader = new ByteReader(bytes, "side information header"),
    version = reader.u8();
  if (version !== VERSION)
    throw new BitstreamError(`side information has version ${version}, this version reads ${VERSION}`);
  const offsets = reader.unsigned(),
    context = reader.unsigned(),
    numGroups = reader.unsigned();
  if (numGroups < 1 || numGroups > MAX_CAUSAL_GROUPS)
    throw new BitstreamError(`side information: ${numGroups} feature groups`);
  const take = (count: number, next: () => number): number[] => Array.from({ length: count }, next);
  const groups = take(numGroups, () => reader.unsigned()),
    linearSteps = take(numGroups + 1, () => reader.f64()),
    voxelSize = reader.f64();
  const stepsOfLogs = take(2, () => reader.unsigned()),
    spread = take(3, () => reader.unsigned());
  const zeroPoints = take(NUM_LOG_SCALINGS, () => reader.signed()),
    middle = take(3, () => reader.signed());
  reader.finish();
  const features = groups.reduce((sum, size) => sum + size, 0);
  const within = (values: readonly number[], low: number, high: number): boolean =>
    values.every((value) => value >= low && value <= high);
  const fine =
    within(groups, 1, MAX_CAUSAL_FEATURES) &&
    features <= MAX_CAUSAL_FEATURES &&
    within([offsets], 1, MAX_CAUSAL_OFFSETS) &&
    within([context], 1, MAX_CAUSAL_CONTEXT) &&
    within([...linearSteps, voxelSize], 1e-9, 1e9) &&
    within(stepsOfLogs, 1, MAX_CAUSAL_STEP_OF_LOGS) &&
    within(zeroPoints, -MAX_CAUSAL_ZERO_POINT, MAX_CAUSAL_ZERO_POINT) &&
    within(spread, 1, MAX_COORD) &&
    within(middle, -MAX_COORD, MAX_COORD);
  if (!fine) throw new BitstreamError("side information: a number of the header is out of range");
  return { groups, features, offsets, context, linearSteps, voxelSize, stepsOfLogs, zeroPoints, middle, spread };
}
