// Side information of decoded columns: the twin of `splatwire.view.columns`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import type { Rule } from "../../conceal/grow.ts";
import type { Affine } from "../../model/affine.ts";
import type { Anchors } from "../../model/anchors.ts";
import type { Mlp } from "../../model/heads.ts";
import { readSections } from "../../packets/sections.ts";
import type { Known } from "../anchor_part.ts";

const VERSION = 1,
  MAX_FEATURES = 4096,
  MAX_OFFSETS = 1024,
  MAX_HIDDEN = 4096;
/**
 * What is known of every anchor: place, expected size, logarithms of how far features and lengths are expected to be
 * off.
 */
const KNOWN = 6;
/** Numbers of a row beside features and offsets: the scale, its mean logarithm, three sizes. */
const FORM = 5;

/** Copies of anchors that the sender left, and how what is there grows around them. */
export interface ColumnCopies {
  readonly ranks: Int32Array;
  readonly rows: Rows;
  readonly rule: Rule;
  readonly trust: number;
}

/** Anchors as they are drawn, and the mean logarithm of each one's three scales. */
export interface Rows extends Known {
  readonly logScales: Float32Array;
}

export interface SideInfo {
  readonly features: number;
  readonly offsets: number;
  /** Half of the anchors are about this near to the middle, world units. */
  readonly size: number;
  readonly middle: number[];
  readonly heads: Mlp[];
  /** `KNOWN` numbers of each anchor, by rank. */
  readonly known: Float32Array;
  readonly copies: ColumnCopies | null;
  readonly sections: Map<string, Uint8Array>;
}

export function readSideInfo(bytes: Uint8Array, count: number): SideInfo {
  const reader = new ByteReader(bytes, "side information"),
    header = new ByteReader(reader.blob(), "side information header");
  const version = header.u8(),
    features = header.unsigned(),
    offsets = header.unsigned(),
    [size, ...middle] = [0, 1, 2, 3].map(() => header.f64());
  header.finish();
  if (version !== VERSION) throw new BitstreamError(`columns have version ${version}, this page reads ${VERSION}`);
  if (
    !(
      features >= 1 &&
      features <= MAX_FEATURES &&
      offsets >= 1 &&
      offsets <= MAX_OFFSETS &&
      size > 0 &&
      size < Infinity &&
      middle.every(Number.isFinite)
    )
  ) {
    throw new BitstreamError("side information: its header is impossible");
  }
  const networks = new ByteReader(reader.blob(), "render networks"),
    heads = [1, 7, 3].map((each) => readMlp(networks, features + 4, offsets * each));
  networks.finish();
  const known = floats(reader.blob()),
    sections = readSections(reader.rest()),
    section = sections.get("copies");
  if (known.length !== KNOWN * count)
    throw new BitstreamError(`side information: ${known.length} numbers of ${count} anchors`);
  const copies = section ? readCopies(section, features, offsets, count) : null;
  return { features, offsets, size, middle, heads, known, copies, sections };
}

/** Anchors of a packet, or copies: rows of floats, then the masks. */
export function readRows(
  bytes: Uint8Array,
  positions: Float32Array,
  { features: size, offsets: numOffsets }: { features: number; offsets: number },
): Rows {
  const count = positions.length / 3,
    width = size + FORM + 3 * numOffsets,
    end = 4 * width * count;
  if (bytes.length !== end + numOffsets * count)
    throw new BitstreamError(`columns: ${bytes.length} bytes of ${count} anchors`);
  const rows = floats(bytes.subarray(0, end)),
    masks = bytes.slice(end).map((there) => (there ? 1 : 0));
  const take = (first: number, each: number): Float32Array =>
    Float32Array.from({ length: each * count }, (_, n) => rows[Math.floor(n / each) * width + first + (n % each)]);
  const anchors: Anchors = {
    count,
    numOffsets,
    positions,
    scales: take(size, 1),
    sizes: take(size + 2, 3),
    masks,
    offsets: take(size + FORM, 3 * numOffsets),
  };
  return { anchors, features: take(0, size), logScales: take(size + 1, 1) };
}

function readCopies(section: Uint8Array, features: number, offsets: number, count: number): ColumnCopies {
  const reader = new ByteReader(section, "section 'copies'"),
    [exponent, maxExcess, trust] = [reader.f32(), reader.f32(), reader.f32()];
  const ranks = Int32Array.from({ length: Math.min(reader.unsigned(), count) }, () =>
    Math.min(reader.u32(), count - 1),
  );
  const positions = floats(reader.take(12 * ranks.length));
  return {
    ranks,
    rows: readRows(reader.rest(), positions, { features, offsets }),
    rule: { exponent, maxExcess },
    trust,
  };
}

function readMlp(reader: ByteReader, inputs: number, outputs: number): Mlp {
  const hidden = reader.unsigned(),
    slope = reader.f32();
  if (!(hidden >= 1 && hidden <= MAX_HIDDEN)) throw new BitstreamError(`side information: ${hidden} hidden numbers`);
  return { hidden: readAffine(reader, inputs, hidden), output: readAffine(reader, hidden, outputs), slope };
}

function readAffine(reader: ByteReader, inputs: number, outputs: number): Affine {
  const weights = Float64Array.from(floats(reader.take(4 * inputs * outputs))),
    bias = Float64Array.from(floats(reader.take(4 * outputs)));
  return { inputs, outputs, weights, bias };
}

function floats(bytes: Uint8Array): Float32Array {
  if (bytes.length % 4) throw new BitstreamError("columns: a number is cut off");
  return new Float32Array(bytes.slice().buffer);
}
