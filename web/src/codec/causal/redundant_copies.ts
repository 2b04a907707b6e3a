// Redundant copies of the most important anchors, stored in the side information. Counterpart of
// `splatwire.concealment.sketch`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import type { Rule } from "../../conceal/grow.ts";
import { RangeDecoder } from "../../entropy/decoder.ts";
import { zeroMeanNormal } from "../../entropy/mixture.ts";
import { NUM_SCALES } from "../../entropy/tables.ts";
import type { Anchors } from "../../model/anchors.ts";

const VERSION = 2,
  WHAT = "section 'sketch'",
  MAX_LEVELS = 8,
  MAX_VALUE = 2 ** 24,
  MAX_DIRECTION = 127,
  MAX_TRUST = 4,
  OFFSET_STEPS = [2 ** -13, 16];
const SCALINGS = 6,
  MAX_LOG_SIZE = 6,
  MIN_SHARE = 0.05,
  MIN_SIZE = 1e-9,
  BUCKET_SHARES = [0.01, 0.03, 0.1, 0.25, 0.5],
  BUCKETS = BUCKET_SHARES.length + 1;
/**
 * Magnitudes up to `OWN_MODELS` have models per column and level. Larger ones share the models of the level. An escape
 * code follows `UNARY`.
 */
const OWN_MODELS = 4,
  UNARY = 14,
  SHARED_MODELS = UNARY - OWN_MODELS,
  HISTORY = 4;

/** Inputs of the decoder that are known before the copies. */
export interface CopyContext {
  readonly count: number;
  readonly features: number;
  readonly offsets: number;
  /** Predicted scale and three sizes of each anchor, shape (count, 4). They are bit-identical on every machine. */
  readonly lengths: Float32Array;
  /** Returns the predicted positions of some anchors, world units. */
  readonly positions: (ranks: Int32Array) => Float32Array;
}

export interface RedundantAnchors {
  readonly ranks: Int32Array;
  readonly anchors: Anchors;
  readonly features: Float32Array;
  /** Growth of received elements, and the weight of the network's correction of it. */
  readonly rule: Rule;
  readonly trust: number;
}

/** Linear map from integers to numbers for level 1. Steps halve from level to level. */
interface Basis {
  readonly levels: number;
  readonly columns: number;
  readonly mean: Float64Array;
  /** Contribution of a unit of each column to each channel, shape (channels, columns). */
  readonly matrix: Float64Array;
  readonly offsetStep: number;
}

interface Rows {
  readonly masks: Uint8Array;
  readonly values: Int32Array;
  readonly offsets: Int32Array;
}

export function readRedundantAnchors(bytes: Uint8Array, known: CopyContext): RedundantAnchors {
  const reader = new ByteReader(bytes, WHAT),
    version = reader.u8(),
    [levels, columns, numOffsets] = [reader.u8(), reader.u8(), reader.u8()];
  if (version !== VERSION) throw new BitstreamError(`${WHAT} has version ${version}, this version reads ${VERSION}`);
  const [count, numCopies] = [reader.u32(), reader.u32()],
    [offsetStep, exponent, maxExcess, trust] = [0, 1, 2, 3].map(() => reader.f32());
  if (count !== known.count || numOffsets !== known.offsets)
    throw new BitstreamError(`${WHAT} is of a scene of ${count} anchors with ${numOffsets} offsets`);
  const channels = known.features + SCALINGS,
    within = (value: number, low: number, high: number): boolean => value >= low && value <= high;
  const sane =
    within(levels, 1, MAX_LEVELS) &&
    within(columns, 1, channels) &&
    numCopies <= count &&
    within(offsetStep, OFFSET_STEPS[0], OFFSET_STEPS[1]) &&
    within(exponent, 0, 4) &&
    within(maxExcess, 1, 16) &&
    within(trust, 0, MAX_TRUST);
  if (!sane) throw new BitstreamError(`${WHAT}: a number of the header is out of range`);
  const basis = readBasis(reader, { levels, columns, offsetStep }, channels),
    coder = new RangeDecoder(reader.rest());
  const level = readLevels(coder, bucketsOf(known), levels),
    ranks = level.map((_, rank) => rank).filter((rank) => level[rank] > 0);
  if (ranks.length !== numCopies)
    throw new BitstreamError(`${WHAT}: ${ranks.length} anchors have copies, but the header has ${numCopies}`);
  const chosen = ranks.map((rank) => level[rank]),
    rows = readRows(coder, basis, chosen, numOffsets);
  return { ranks, ...toAnchors(basis, chosen, rows, known, ranks), rule: { exponent, maxExcess }, trust };
}

function readBasis(
  reader: ByteReader,
  { levels, columns, offsetStep }: Pick<Basis, "levels" | "columns" | "offsetStep">,
  channels: number,
): Basis {
  const numbers = Float64Array.from({ length: channels + columns }, () => reader.f16());
  if (!numbers.every(Number.isFinite)) throw new BitstreamError(`${WHAT}: a number of its tables is not finite`);
  const scales = Array.from({ length: columns }, () => reader.unsigned());
  if (scales.some((scale) => scale >= NUM_SCALES))
    throw new BitstreamError(`${WHAT}: a scale of its basis is out of range`);
  const coder = new RangeDecoder(reader.blob()),
    matrix = new Float64Array(channels * columns);
  scales.forEach((scale, c) => {
    for (let d = 0; d < channels; d++) {
      const direction = zeroMeanNormal(scale).decode(coder);
      if (Math.abs(direction) > MAX_DIRECTION)
        throw new BitstreamError(`${WHAT}: a number of its basis is out of range`);
      matrix[d * columns + c] = direction * numbers[channels + c];
    }
  });
  return { levels, columns, offsetStep, mean: numbers.subarray(0, channels), matrix };
}

/** Returns the bucket of each anchor by predicted size. Bucket 0 has the largest anchors. */
function bucketsOf({ count, lengths }: CopyContext): Uint8Array {
  const size = Float64Array.from(
      { length: count },
      (_, n) => lengths[4 * n + 1] * lengths[4 * n + 2] * lengths[4 * n + 3],
    ),
    buckets = new Uint8Array(count);
  const order = Int32Array.from({ length: count }, (_, n) => n).sort((a, b) => size[b] - size[a] || a - b);
  const edges = BUCKET_SHARES.map((share) => Math.floor(share * count));
  order.forEach((rank, place) => (buckets[rank] = edges.filter((edge) => edge <= place).length));
  return buckets;
}

const initialModels = (contexts: number): Int32Array => new Int32Array(2 * contexts).fill(32768);

/** Decodes the level of each anchor; 0 if it has no copy. */
function readLevels(coder: RangeDecoder, buckets: Uint8Array, most: number): Int32Array {
  const models = initialModels(BUCKETS * HISTORY + most),
    levels = new Int32Array(buckets.length);
  for (let n = 0; n < levels.length; n++) {
    let before = 0;
    for (let i = Math.max(n - 4, 0); i < n; i++) if (levels[i]) before++;
    if (!coder.bit(models, buckets[n] * HISTORY + Math.min(before, HISTORY - 1))) continue;
    for (levels[n] = 1; levels[n] < most && coder.bit(models, BUCKETS * HISTORY + levels[n]); ) levels[n]++;
  }
  return levels;
}

function readRows(coder: RangeDecoder, { levels: most, columns }: Basis, levels: Int32Array, numOffsets: number): Rows {
  const wide = (columns + 3) * (1 + OWN_MODELS),
    bits = initialModels(numOffsets * HISTORY),
    models = initialModels(most * (wide + SHARED_MODELS)),
    count = levels.length;
  const masks = new Uint8Array(count * numOffsets),
    values = new Int32Array(count * columns),
    offsets = new Int32Array(3 * count * numOffsets);
  levels.forEach((level, n) => {
    const first = (level - 1) * (wide + SHARED_MODELS),
      value = (column: number): number => readValue(coder, models, first + column * (1 + OWN_MODELS), first + wide);
    for (let k = 0, ones = 0; k < numOffsets; k++)
      ones += masks[n * numOffsets + k] = coder.bit(bits, k * HISTORY + Math.min(ones, HISTORY - 1));
    for (let c = 0; c < columns; c++) values[n * columns + c] = value(c);
    for (let k = n * numOffsets; k < (n + 1) * numOffsets; k++)
      if (masks[k]) for (let a = 0; a < 3; a++) offsets[3 * k + a] = value(columns + a);
  });
  return { masks, values, offsets };
}

/** Decodes an integer: zero flag, sign, magnitude in unary coding, escape code. */
function readValue(coder: RangeDecoder, models: Int32Array, own: number, shared: number): number {
  if (!coder.bit(models, own)) return 0;
  const sign = coder.raw(1) ? -1 : 1;
  let size = 0;
  while (size < UNARY && coder.bit(models, size < OWN_MODELS ? own + 1 + size : shared + size - OWN_MODELS)) size++;
  if (size === UNARY) size += coder.gamma();
  if (size + 1 >= MAX_VALUE) throw new BitstreamError(`${WHAT}: values out of range`);
  return sign * (size + 1);
}

/**
 * Converts the copies to anchors. Stored offsets have one unit per axis, those of anchors a common one: the geometric
 * mean.
 */
function toAnchors(
  { columns, mean, matrix, offsetStep }: Basis,
  levels: Int32Array,
  rows: Rows,
  known: CopyContext,
  ranks: Int32Array,
): Pick<RedundantAnchors, "anchors" | "features"> {
  const count = levels.length,
    { features: size, offsets: numOffsets } = known,
    features = new Float32Array(count * size),
    least = minLengths(known.lengths);
  const scales = new Float32Array(count),
    sizes = new Float32Array(3 * count),
    offsets = new Float32Array(3 * count * numOffsets);
  levels.forEach((level, n) => {
    const step = 0.5 ** (level - 1),
      channel = (d: number): number => {
        let sum = 0;
        for (let c = 0; c < columns; c++) sum += rows.values[n * columns + c] * step * matrix[d * columns + c];
        return Math.fround(mean[d] + sum);
      };
    const length = (a: number): number => {
      const column = Math.max(a - 2, 0),
        expected = Math.max(known.lengths[4 * ranks[n] + column], least[column]);
      return Math.exp(Math.min(Math.max(channel(size + a), -MAX_LOG_SIZE), MAX_LOG_SIZE)) * expected;
    };
    for (let c = 0; c < size; c++) features[n * size + c] = channel(c);
    const units = [length(0), length(1), length(2)];
    scales[n] = Math.cbrt(units[0] * units[1] * units[2]);
    for (let a = 0; a < 3; a++) sizes[3 * n + a] = length(3 + a);
    for (let k = 3 * n * numOffsets; k < 3 * (n + 1) * numOffsets; k++)
      offsets[k] = (rows.offsets[k] * offsetStep * step * units[k % 3]) / scales[n];
  });
  return {
    anchors: { count, numOffsets, positions: known.positions(ranks), scales, sizes, masks: rows.masks, offsets },
    features,
  };
}

/** Returns the lower bounds of the predicted lengths, a share of their medians. */
function minLengths(lengths: Float32Array): number[] {
  return [0, 1, 2, 3].map((column) => {
    const all = lengths.filter((_, n) => n % 4 === column).sort();
    return Math.max(MIN_SHARE * (all[(all.length - 1) >> 1] ?? 0), MIN_SIZE);
  });
}
