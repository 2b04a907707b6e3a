// The manifest: what must be known of a stream before its first byte is decoded. Believed only where its digest holds.

import { sha256 } from "@noble/hashes/sha2.js";

import { BitstreamError, hex } from "../bytes.ts";

export const FORMAT_VERSION = 2;
export const MAX_MANIFEST_BYTES = 1 << 16;
const MAX_ELEMENTS = 2 ** 28, MAX_BLOCK = 65535, FREE_ELEMENTS = 65536, ELEMENTS_PER_BYTE = 1024;

export interface Packetization {
  readonly blockSize: number;
  readonly lanes: number;
  /** Low and high half. */
  readonly seed: readonly [number, number];
  readonly grouping: "stratified" | "contiguous" | "hashed";
  readonly packetBytes: number;
}

export interface TierShape {
  readonly count: number;
  readonly lanes: number;
}

export interface Manifest {
  readonly codec: "gaussians" | "causal" | "hacpp";
  readonly packetization: Packetization;
  readonly count: number;
  readonly numPackets: number;
  readonly streamId: number;
  readonly sideInfoBytes: number;
  readonly sideInfoDigest: string;
  readonly symbolsDigest: string;
  readonly tiers: readonly TierShape[];
  readonly writer: string;
}

type Fields = Record<string, unknown>;

/** Reads a manifest as splatwire writes it: JSON with sorted keys and without blanks, over which its digest is taken. */
export function readManifest(bytes: Uint8Array): Manifest {
  if (bytes.length > MAX_MANIFEST_BYTES) throw new BitstreamError(`a manifest cannot have ${bytes.length} bytes`);
  let text: string, fields: Fields;
  try {
    text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
    fields = JSON.parse(text) as Fields;
  } catch {
    throw new BitstreamError("the manifest is not JSON");
  }
  if (fields === null || typeof fields !== "object" || fields["schema"] !== "splatwire/stream") {
    throw new BitstreamError("this is not a splatwire stream");
  }
  const version = integer(fields, "format_version", 1, 2 ** 31);
  if (version > FORMAT_VERSION) {
    throw new BitstreamError(`the stream has format version ${version}, this page reads up to ${FORMAT_VERSION}`);
  }
  const content = text.replace(/"digest":"[0-9a-f]{16}",/, "");
  if (hex(sha256(new TextEncoder().encode(content))).slice(0, 16) !== fields["digest"]) {
    throw new BitstreamError("the manifest is damaged: its digest does not match");
  }
  const codec = version === 1 ? "hacpp" : words(fields, "codec", ["gaussians", "causal"]);
  const sideInfoBytes = integer(fields, "side_info_bytes", 0, 2 ** 32 - 1);
  const manifest: Manifest = {
    codec,
    packetization: readPacketization(fields["packetization"] as Fields, text),
    count: integer(fields, "num_anchors", 0, Math.min(MAX_ELEMENTS, FREE_ELEMENTS + ELEMENTS_PER_BYTE * sideInfoBytes)),
    numPackets: integer(fields, "num_packets", 0, 2 ** 31),
    streamId: parseInt(pattern(fields, "stream_id", /^[0-9a-f]{8}$/), 16),
    sideInfoBytes,
    sideInfoDigest: pattern(fields, "side_info_digest", /^[0-9a-f]{64}$/),
    symbolsDigest: pattern(fields, "symbols_digest", /^[0-9a-f]{64}$/),
    tiers: readTiers(fields["tiers"]),
    writer: pattern(fields, "writer", /^[ -~]{0,80}$/),
  };
  const inTiers = manifest.tiers.reduce((sum, tier) => sum + tier.count, 0);
  if (manifest.tiers.length && inTiers !== manifest.count) throw new BitstreamError("the manifest's tiers do not add up");
  if (manifest.numPackets > manifest.count) throw new BitstreamError("the manifest has more packets than Gaussians");
  return manifest;
}

function readPacketization(fields: Fields, text: string): Packetization {
  if (fields === null || typeof fields !== "object") throw new BitstreamError("the manifest has no packetization");
  const grouping = words(fields, "grouping", ["stratified", "contiguous", "hashed"]);
  const seed = BigInt(/"seed":(\d{1,20})[,}]/.exec(text)?.[1] ?? "0"); // JSON.parse would round it
  return {
    blockSize: integer(fields, "block_size", 1, MAX_BLOCK),
    lanes: integer(fields, "lanes", 1, 256),
    seed: [Number(seed & 0xffffffffn), Number((seed >> 32n) & 0xffffffffn)],
    grouping,
    packetBytes: grouping === "hashed" ? integer(fields, "packet_bytes", 128, 65507) : 2 ** 26,
  };
}

function readTiers(value: unknown): TierShape[] {
  if (value === undefined) return [];
  if (!Array.isArray(value) || value.length < 2 || value.length > 8) throw new BitstreamError("the manifest's tiers are impossible");
  return value.map((pair: unknown) => {
    const [count, lanes] = Array.isArray(pair) ? (pair as unknown[]) : [];
    const fields = { count, lanes };
    return { count: integer(fields, "count", 1, MAX_ELEMENTS), lanes: integer(fields, "lanes", 1, 256) };
  });
}

function integer(fields: Fields, name: string, low: number, high: number): number {
  const value = fields[name];
  if (typeof value !== "number" || !Number.isInteger(value) || value < low || value > high) {
    throw new BitstreamError(`the manifest's ${name} is impossible`);
  }
  return value;
}

function pattern(fields: Fields, name: string, expected: RegExp): string {
  const value = fields[name];
  if (typeof value !== "string" || !expected.test(value)) throw new BitstreamError(`the manifest's ${name} is impossible`);
  return value;
}

function words<W extends string>(fields: Fields, name: string, known: readonly W[]): W {
  const found = known.find((word) => word === fields[name]);
  if (found === undefined) throw new BitstreamError(`the manifest's ${name} is none that this page knows`);
  return found;
}
