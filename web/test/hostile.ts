// Hostile bytes with correct checksums, for hostile.test.ts and the fuzz run.

import assert from "node:assert/strict";

import { BitstreamError } from "../src/bytes.ts";
import { AnchorPrediction } from "../src/codec/causal/anchor_prediction.ts";
import { PacketDecoder } from "../src/codec/causal/packet.ts";
import { readRedundantAnchors } from "../src/codec/causal/redundant_copies.ts";
import { readSideInfo as readAnchors } from "../src/codec/causal/side_info.ts";
import { StreamDecoder } from "../src/codec/decoder.ts";
import { readRedundantGaussians } from "../src/codec/gaussians/redundant_copies.ts";
import { readSideInfo as readGaussians } from "../src/codec/gaussians/side_info.ts";
import { readPreview } from "../src/codec/preview.ts";
import { ContainerReader, type Head } from "../src/packets/container.ts";
import { crc32 } from "../src/packets/crc32.ts";
import { Intake, Plan } from "../src/packets/plan.ts";
import { random } from "./vectors.ts";

/** Camera that sees most of the space around the origin. */
export const CAMERA = {
  viewmat: [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 5],
  ],
  focal: 100,
  width: 200,
  height: 200,
  margin: 0,
};

type Random = () => number;

const below = (next: Random, count: number): number => Math.floor(next() * count);

/** Returns a copy with some bytes changed, sometimes truncated or extended. */
export function spoiled(bytes: Uint8Array, next: Random, from = 0): Uint8Array {
  const length =
    next() < 0.15
      ? from + below(next, bytes.length - from + 1)
      : next() < 0.1
        ? bytes.length + below(next, 40)
        : bytes.length;
  const copy = new Uint8Array(length);
  copy.set(bytes.subarray(0, length));
  for (let n = 1 + below(next, 1 + 2 ** below(next, 7)); n > 0 && length > from; n--)
    copy[from + below(next, length - from)] = below(next, 256);
  return copy;
}

/** Returns a packet with a changed payload, sometimes a changed header, and a correct checksum. */
function hostilePacket(bytes: Uint8Array, next: Random): Uint8Array {
  const packet = next() < 0.1 ? Uint8Array.from(bytes) : spoiled(bytes, next, 16),
    view = new DataView(packet.buffer);
  if (next() < 0.3) view.setUint16(10, 1 + below(next, 65535), true);
  if (next() < 0.2) packet[5 + below(next, 5)] = below(next, 256);
  if (packet.length >= 16) view.setUint32(12, crc32(packet.subarray(16), crc32(packet.subarray(0, 12))), true);
  return packet;
}

function decodePacket(decoder: StreamDecoder, bytes: Uint8Array): number {
  const packet = new Intake(decoder.intake.plan).offer(bytes);
  if (!packet) return 0;
  const { splats } = decoder.elementDecoder.read(packet).forCamera(CAMERA);
  for (const values of [
    splats.means,
    splats.quats,
    splats.scales,
    splats.opacities,
    splats.colours,
    splats.harmonics,
  ]) {
    assert.ok(values.every(Number.isFinite), "a number that is none");
  }
  assert.ok(
    splats.opacities.every((opacity) => opacity >= 0 && opacity <= 1) && splats.scales.every((scale) => scale >= 0),
  );
  return packet.count;
}

/**
 * Reads hostile sections of redundant copies. Each gives finite numbers or throws BitstreamError. Returns the number of
 * readable ones.
 */
export async function attackCopies(head: Head, cases: number, seed: number): Promise<number> {
  const next = random(seed),
    elementDecoder = new StreamDecoder(head).elementDecoder,
    section = elementDecoder.sections.get("sketch")!,
    read = await readerOf(head);
  let found = 0;
  for (let n = 0; n < cases; n++) {
    try {
      for (const values of read(spoiled(section, next, next() < 0.8 ? 40 : 0)))
        assert.ok(values.every(Number.isFinite), "a number that is none");
      found++;
    } catch (error) {
      assert.ok(error instanceof BitstreamError, `case ${n} of seed ${seed}: ${(error as Error).stack}`);
    }
  }
  return found;
}

/** Returns a function that decodes a section of redundant copies to arrays. */
async function readerOf({ manifest, sideInfo }: Head): Promise<(section: Uint8Array) => Float32Array[]> {
  const { count } = manifest;
  if (manifest.codec === "gaussians") {
    const info = readGaussians(sideInfo, new Plan(manifest).numBlocks);
    return (section) => {
      const { means, scales, quats, opacities, colours, harmonics } = readRedundantGaussians(
        section,
        info,
        count,
      ).splats;
      return [means, scales, quats, opacities, colours, harmonics];
    };
  }
  const info = readAnchors(sideInfo, count),
    expected = new AnchorPrediction(new PacketDecoder(info), count, null),
    { features, offsets } = info;
  const lengths = (await expected.lengths(() => Promise.resolve(true)))!,
    positions = (ranks: Int32Array): Float32Array => expected.positions(ranks);
  return (section) => {
    const { anchors, features: found } = readRedundantAnchors(section, {
      count,
      features,
      offsets,
      lengths,
      positions,
    });
    return [anchors.positions, anchors.scales, anchors.sizes, anchors.offsets, found];
  };
}

/** Decodes hostile packets. Only BitstreamError may be thrown. Returns the number of packets that decoded. */
export function attack(head: Head, packets: Uint8Array[], cases: number, seed: number): number {
  const next = random(seed),
    decoder = new StreamDecoder(head),
    preview = Uint8Array.from({ length: 62 }, () => below(next, 256));
  let decoded = 0;
  for (let n = 0; n < cases; n++) {
    const kind = next();
    try {
      if (kind < 0.8)
        decoded += decodePacket(decoder, hostilePacket(packets[below(next, packets.length)], next)) ? 1 : 0;
      else if (kind < 0.9) new StreamDecoder({ ...head, sideInfo: spoiled(head.sideInfo, next) });
      else if (kind < 0.95) readPreview(spoiled(preview, next));
      else new ContainerReader().feed(spoiled(packets[below(next, packets.length)], next));
    } catch (error) {
      assert.ok(error instanceof BitstreamError, `case ${n} of seed ${seed}: ${(error as Error).stack}`);
    }
  }
  return decoded;
}
