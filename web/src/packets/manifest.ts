// Manifest of a stream. Accepts the same manifests as `splatwire.bitstream.manifest`.

import { BitstreamError } from "../bytes.ts";
import { sha256 } from "../sha256.ts";
import { type Fields, type Json, parseJson, writeJson } from "./json.ts";
import * as limits from "./limits.ts";

export interface Packetization {
  readonly blockSize: number;
  readonly lanes: number;
  /** Low and high 32 bits. */
  readonly seed: readonly [number, number];
  readonly order: string;
  readonly grouping: string;
  readonly packaging: string;
  readonly packetBytes: number;
}

export interface TierCounts {
  readonly count: number;
  readonly lanes: number;
}

export interface Manifest {
  readonly codec: keyof typeof limits.SCHEMAS;
  readonly packetization: Packetization;
  readonly count: number;
  readonly numPackets: number;
  readonly streamId: number;
  readonly sideInfoBytes: number;
  readonly sideInfoDigest: string;
  readonly symbolsDigest: string;
  readonly tiers: readonly TierCounts[];
  readonly writer: string;
}

const SHA256 = /^[0-9a-f]{64}$/,
  WRITER = new RegExp(`^[ -~]{0,${limits.MAX_WRITER_LENGTH}}$`);
const FIELDS = [
  "digest",
  "format_version",
  "num_anchors",
  "num_packets",
  "packetization",
  "schema",
  "side_info_bytes",
  "side_info_digest",
  "stream_id",
  "symbols_digest",
  "writer",
];
const LAYOUT = ["feature_dim", "feature_groups", "num_offsets"];
const PACKETIZATION = ["block_size", "grouping", "lanes", "order", "packaging", "seed"];

/** Returns true if the digest in a manifest is that of its other fields. The values of the fields are not checked. */
export function isIntactManifest(bytes: Uint8Array): boolean {
  try {
    const fields = parseJson(decoded(bytes));
    return fields instanceof Map && hasOwnDigest(fields);
  } catch (error) {
    if (error instanceof BitstreamError) return false;
    throw error;
  }
}

function hasOwnDigest(fields: Fields): boolean {
  const content = new Map(fields);
  content.delete("digest");
  return sha256(new TextEncoder().encode(writeJson(content))).slice(0, 16) === fields.get("digest");
}

/** Reads a manifest and checks every field by itself and against the others. Throws `BitstreamError`. */
export function readManifest(bytes: Uint8Array): Manifest {
  if (bytes.length > limits.MAX_MANIFEST_BYTES)
    throw new BitstreamError(`a manifest cannot have ${bytes.length} bytes`);
  const fields = parseJson(decoded(bytes));
  if (!(fields instanceof Map) || fields.get("schema") !== limits.MANIFEST_FORMAT)
    throw new BitstreamError("not a splatwire stream");
  const version = integer(fields, "format_version", 1, Number.MAX_SAFE_INTEGER);
  if (version > limits.FORMAT_VERSION) {
    throw new BitstreamError(
      `the stream has format version ${version}, this version reads up to ${limits.FORMAT_VERSION}`,
    );
  }
  checkFieldNames(fields, [
    ...FIELDS,
    ...(version === 1 ? LAYOUT : ["codec"]),
    ...(fields.has("tiers") ? ["tiers"] : []),
  ]);
  if (!hasOwnDigest(fields)) throw new BitstreamError("the manifest is damaged: its digest does not match");
  const codec = version === 1 ? "hacpp" : (choice(fields, "codec", Object.keys(limits.SCHEMAS)) as Manifest["codec"]);
  const { formatVersion, elementsPerByte, maxTiers, timed } = limits.SCHEMAS[codec],
    sideInfoBytes = integer(fields, "side_info_bytes", 0, limits.MAX_SIDE_INFO_BYTES);
  if (formatVersion !== version) throw new BitstreamError(`format version ${version} has no codec ${codec}`);
  const manifest: Manifest = {
    codec,
    packetization: readPacketization(fields.get("packetization")),
    count: integer(
      fields,
      "num_anchors",
      0,
      Math.min(limits.MAX_ELEMENTS, limits.FREE_ELEMENTS + elementsPerByte * sideInfoBytes),
    ),
    numPackets: integer(fields, "num_packets", 0, Number.MAX_SAFE_INTEGER),
    streamId: parseInt(pattern(fields, "stream_id", /^[0-9a-f]{8}$/), 16),
    sideInfoBytes,
    sideInfoDigest: pattern(fields, "side_info_digest", SHA256),
    symbolsDigest: pattern(fields, "symbols_digest", SHA256),
    tiers: fields.has("tiers") ? readTiers(fields.get("tiers"), maxTiers, timed) : [],
    writer: pattern(fields, "writer", WRITER),
  };
  if (timed && !manifest.tiers.length) throw new BitstreamError("the manifest has no groups of frames");
  checkPlan(manifest, version === 1 ? readGroups(fields) : []);
  return manifest;
}

function decoded(bytes: Uint8Array): string {
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    throw new BitstreamError("the manifest is not text");
  }
}

function readPacketization(fields: Json | undefined): Packetization {
  if (!(fields instanceof Map)) throw new BitstreamError("the manifest has no packetization");
  const grouping = choice(fields, "grouping", limits.GROUPINGS),
    packaging = choice(fields, "packaging", limits.PACKAGINGS),
    hashed = grouping === "hashed";
  checkFieldNames(fields, [...PACKETIZATION, ...(hashed ? ["packet_bytes"] : [])]);
  const seed = fields.get("seed");
  if (typeof seed !== "bigint" || seed < 0n || seed >= 1n << 64n)
    throw new BitstreamError("the manifest's seed is missing or out of range");
  if (hashed && packaging !== "atomic") throw new BitstreamError("hashed grouping needs atomic packaging");
  return {
    blockSize: integer(fields, "block_size", 1, hashed ? limits.MAX_HASHED_BLOCK : limits.MAX_BLOCK_SIZE),
    lanes: integer(fields, "lanes", 1, hashed ? 1 : limits.MAX_LANES),
    seed: [Number(seed & 0xffffffffn), Number((seed >> 32n) & 0xffffffffn)],
    order: choice(fields, "order", limits.CODING_ORDERS),
    grouping,
    packaging,
    packetBytes: hashed
      ? integer(fields, "packet_bytes", limits.MIN_PACKET_BYTES, limits.MAX_HASHED_PACKET_BYTES)
      : limits.MAX_PACKET_BYTES,
  };
}

/** Reads the tiers. Streams with frames have two tiers per group of frames; either may be empty. */
function readTiers(value: Json | undefined, most: number, timed: boolean): TierCounts[] {
  if (!Array.isArray(value) || value.length < 2 || value.length > most || (timed && value.length % 2))
    throw new BitstreamError("the manifest's tiers are invalid");
  return value.map((pair) => {
    const [count, lanes] = Array.isArray(pair) && pair.length === 2 ? pair : [];
    const fields: Fields = new Map([
      ["count", count ?? null],
      ["lanes", lanes ?? null],
    ]);
    return {
      count: integer(fields, "count", timed ? 0 : 1, limits.MAX_ELEMENTS),
      lanes: integer(fields, "lanes", 1, limits.MAX_LANES),
    };
  });
}

/** Reads the sizes of the feature groups of an anchor. */
function readGroups(fields: Fields): number[] {
  const features = integer(fields, "feature_dim", 1, limits.MAX_FEATURE_DIM),
    groups = fields.get("feature_groups");
  integer(fields, "num_offsets", 1, limits.MAX_OFFSETS);
  if (!Array.isArray(groups)) throw new BitstreamError("the manifest's feature_groups are not a list");
  const sizes = groups.map((size) => integer(new Map([["feature_groups", size]]), "feature_groups", 1, features));
  if (sizes.reduce((sum, size) => sum + size, 0) !== features)
    throw new BitstreamError("the manifest's feature_groups do not add up");
  return sizes;
}

/** Checks the numbers of blocks and packets for consistency. */
function checkPlan({ packetization, count, numPackets, tiers }: Manifest, groups: number[]): void {
  const { blockSize, lanes, grouping, packaging } = packetization,
    separated = packaging === "separated",
    parts = separated ? 2 + groups.length : 1;
  const tierCounts = tiers.length ? tiers : [{ count, lanes }],
    blocks = tierCounts.map((tier) => Math.ceil(tier.count / blockSize));
  const numBlocks = blocks.reduce((sum, some) => sum + some, 0),
    inTiers = tierCounts.reduce((sum, tier) => sum + tier.count, 0);
  const maxPackets = tierCounts.reduce((sum, tier, n) => sum + Math.min(tier.count, blocks[n] * tier.lanes), 0) * parts;
  const checks: [boolean, string][] = [
    [
      !separated || (groups.length >= 1 && groups.length <= limits.MAX_FEATURE_GROUPS),
      "separated packets need feature groups",
    ],
    [
      inTiers === count && tierCounts.every((tier) => tier.lanes <= lanes),
      "the manifest's tiers do not add up to its elements or lanes",
    ],
    [!tiers.length || !separated, "separated packaging does not support tiers"],
    [numBlocks <= limits.MAX_BLOCKS && numBlocks * lanes <= limits.MAX_STREAM_LANES, "the stream has too many blocks"],
    [
      numPackets >= numBlocks * parts &&
        numPackets <= (grouping === "hashed" ? count : maxPackets) &&
        numPackets % parts === 0,
      `${numPackets} packets cannot carry ${count} elements`,
    ],
  ];
  for (const [fine, wrong] of checks) if (!fine) throw new BitstreamError(wrong);
}

function checkFieldNames(fields: Fields, names: readonly string[]): void {
  if (fields.size !== names.length || !names.every((name) => fields.has(name)))
    throw new BitstreamError("the manifest has missing or unknown fields");
}

function integer(fields: Fields, name: string, low: number, high: number): number {
  const value = fields.get(name);
  if (typeof value !== "bigint" || value < BigInt(low) || value > BigInt(high))
    throw new BitstreamError(`the manifest's ${name} is missing or out of range`);
  return Number(value);
}

function pattern(fields: Fields, name: string, expected: RegExp): string {
  const value = fields.get(name);
  if (typeof value !== "string" || !expected.test(value))
    throw new BitstreamError(`the manifest's ${name} is missing or out of range`);
  return value;
}

function choice(fields: Fields, name: string, known: readonly string[]): string {
  const found = known.find((word) => word === fields.get(name));
  if (found === undefined) throw new BitstreamError(`the manifest's ${name} is unknown to this version`);
  return found;
}
