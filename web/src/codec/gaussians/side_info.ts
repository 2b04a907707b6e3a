// Side information of a stream of explicit Gaussians.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { RangeDecoder } from "../../entropy/decoder.ts";
import { readIntegers } from "../../entropy/integers.ts";
import { NUM_SCALES } from "../../entropy/tables.ts";
import { MAX_DEGREE, MAX_SIZE_LOG } from "../../packets/limits.ts";
import { readSections } from "../../packets/sections.ts";
import {
  BITS,
  BOX_BITS,
  FIRST_HARMONIC,
  MAX_LATTICE_BITS,
  NUM_CONTEXTS,
  NUM_DEVIATION_CONTEXTS,
  NUM_MAGNITUDE_CONTEXTS,
  RESIDUAL_KINDS,
  SCALE_INDEX_STEP,
  STEP_BITS,
  STEPS,
} from "./layout.ts";

const VERSION = 3,
  NUM_BLOCK_MEANS = 7;
/** Format version with integers in whole steps from the prediction by neighbours in the same packet. */
const RELATIVE_VERSION = 2;

export interface SideInfo {
  readonly degree: number;
  /** Number of integers of the harmonics of a Gaussian: 3 K, for K harmonics above degree 0. */
  readonly numHarmonicColumns: number;
  /** log2 of the scene size: the Gaussians' median distance from their median position, rounded down; world units. */
  readonly sizeLog: number;
  /** Positions lie on a lattice with a spacing of `2^(sizeLog - latticeBits)` world units. */
  readonly latticeBits: number;
  /** `-log2` of the quantisation step of each quantity in precision class 0, `STEP_BITS` fractional bits. */
  readonly baseExponents: Int32Array;
  /** log2 of the largest position step in lattice units; -1 in version 2, where values are relative to predictions. */
  readonly maxPositionShift: number;
  /**
   * Transform, shape (K, K), out of `TRANSFORM_UNIT`. Row k is the contribution of a channel's k-th number to its K
   * harmonics.
   */
  readonly transform: Int8Array;
  readonly boxes: Boxes;
  /** Mean attributes of each block in fixed point, shape (blocks, 7): opacity, three of scales, Y Co Cg. */
  readonly blockMeans: Int32Array;
  /** Initial state of the adaptive models of each packet, two estimates per context. */
  readonly models: Int32Array;
  /** Scale table entries of the narrow components of residuals, by kind, deviation context and magnitude context. */
  readonly scaleIndices: Int32Array;
  readonly sections: Map<string, Uint8Array>;
}

export interface Boxes {
  readonly shifts: Int32Array;
  /** Lower corners in lattice units, shape (blocks, 3). */
  readonly corners: Float64Array;
  /** Sides minus one in units of `2^shift`, shape (blocks, 3). */
  readonly extents: Uint8Array;
  /** Bits of a coordinate within each box. */
  readonly bits: Int32Array;
}

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);

export function readSideInfo(bytes: Uint8Array, numBlocks: number): SideInfo {
  const reader = new ByteReader(bytes, "side information");
  const header = reader.blob(),
    blocks = reader.blob(),
    contexts = reader.blob();
  const sections = readSections(reader.rest());
  const fields = readHeader(header),
    { degree } = fields;
  const { boxes, blockMeans } = readBlocks(blocks, numBlocks);
  const numHarmonicColumns = 3 * ((degree + 1) ** 2 - 1);
  return { ...fields, numHarmonicColumns, boxes, blockMeans, ...readContexts(contexts, degree), sections };
}

function readHeader(
  bytes: Uint8Array,
): Pick<SideInfo, "degree" | "sizeLog" | "latticeBits" | "baseExponents" | "maxPositionShift" | "transform"> {
  const reader = new ByteReader(bytes, "side information header"),
    version = reader.u8();
  if (version !== RELATIVE_VERSION && version !== VERSION)
    throw new BitstreamError(
      `side information has version ${version}, this version reads ${RELATIVE_VERSION} and ${VERSION}`,
    );
  const degree = reader.u8(),
    sizeLog = reader.signed(),
    latticeBits = reader.signed();
  const baseExponents = Array.from({ length: STEPS }, () => reader.signed());
  const maxPositionShift = version === RELATIVE_VERSION ? -1 : reader.u8();
  const transform = Int8Array.from(reader.rest(), (byte) => (byte << 24) >> 24),
    numHarmonics = (degree + 1) ** 2 - 1;
  if (
    degree > MAX_DEGREE ||
    Math.abs(sizeLog) > MAX_SIZE_LOG ||
    latticeBits < 0 ||
    latticeBits > MAX_LATTICE_BITS ||
    maxPositionShift > MAX_LATTICE_BITS ||
    baseExponents.some((exponent) => Math.abs(exponent) > 64 << STEP_BITS)
  ) {
    throw new BitstreamError("side information: a number of the header is out of range");
  }
  if (transform.length !== numHarmonics ** 2)
    throw new BitstreamError(`side information: a transform of ${transform.length} entries, not ${numHarmonics ** 2}`);
  return { degree, sizeLog, latticeBits, baseExponents: Int32Array.from(baseExponents), maxPositionShift, transform };
}

/** Reads the boxes and means of blocks. */
export function readBlocks(bytes: Uint8Array, numBlocks: number): Pick<SideInfo, "boxes" | "blockMeans"> {
  const reader = new ByteReader(bytes, "side information blocks");
  if (numBlocks * 7 > bytes.length)
    throw new BitstreamError(`side information: ${bytes.length} bytes cannot hold ${numBlocks} boxes`);
  const shifts = new Int32Array(numBlocks),
    corners = new Float64Array(3 * numBlocks),
    extents = new Uint8Array(3 * numBlocks);
  const bits = new Int32Array(numBlocks),
    blockMeans = new Int32Array(NUM_BLOCK_MEANS * numBlocks);
  for (let block = 0; block < numBlocks; block++) {
    const shift = (shifts[block] = reader.u8()),
      unit = 2 ** shift;
    for (let a = 0; a < 3; a++) corners[3 * block + a] = reader.signed() * unit;
    for (let a = 0; a < 3; a++) extents[3 * block + a] = reader.u8();
    const far = corners.subarray(3 * block, 3 * block + 3).some((corner) => Math.abs(corner) > 2 ** MAX_LATTICE_BITS);
    if (shift > MAX_LATTICE_BITS - BOX_BITS || far)
      throw new BitstreamError("side information: the box of a block is out of range");
    bits[block] = shift + 32 - Math.clz32(Math.max(...extents.subarray(3 * block, 3 * block + 3)));
  }
  for (let c = 0; c < NUM_BLOCK_MEANS; c++) {
    readIntegers(reader, numBlocks).forEach(
      (value, block) => (blockMeans[NUM_BLOCK_MEANS * block + c] = clip(value, -512, 512) * 2 ** (BITS - 4)),
    );
  }
  reader.finish();
  return { boxes: { shifts, corners, extents, bits }, blockMeans };
}

function readContexts(bytes: Uint8Array, degree: number): Pick<SideInfo, "models" | "scaleIndices"> {
  const reader = new ByteReader(bytes, "side information contexts"),
    zeroProbabilities = reader.blob();
  const expected = degree ? NUM_CONTEXTS : FIRST_HARMONIC;
  if (zeroProbabilities.length !== expected)
    throw new BitstreamError(`side information: ${zeroProbabilities.length} models of bits, not ${expected}`);
  const models = Int32Array.from(
    { length: 2 * NUM_CONTEXTS },
    (_, i) => (i >> 1 < expected ? clip(zeroProbabilities[i >> 1], 1, 255) : 128) * 256,
  );
  const coder = new RangeDecoder(reader.blob()),
    evenModel = new Int32Array(4).fill(32768);
  const changed = Uint8Array.from(
    { length: RESIDUAL_KINDS * NUM_DEVIATION_CONTEXTS * NUM_MAGNITUDE_CONTEXTS },
    (_, i) => coder.bit(evenModel, i % NUM_MAGNITUDE_CONTEXTS ? 0 : 1),
  );
  const steps = readIntegers(
    reader,
    changed.reduce((sum, bit) => sum + bit, 0),
  );
  reader.finish();
  let next = 0,
    sum = 0;
  const scaleIndices = Int32Array.from(changed, (bit, i) => {
    if (i % NUM_MAGNITUDE_CONTEXTS === 0) sum = 0;
    if (bit) sum += steps[next++];
    return clip(sum, 0, NUM_SCALES / SCALE_INDEX_STEP - 1) * SCALE_INDEX_STEP;
  });
  return { models, scaleIndices };
}
