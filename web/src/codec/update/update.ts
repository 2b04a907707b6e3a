// Reader of updates: streams that contain only the changes of a scene of explicit Gaussians. Counterpart of
// `splatwire.codec.update`.

import { BitstreamError, ByteReader, hex } from "../../bytes.ts";
import { RangeDecoder } from "../../entropy/decoder.ts";
import { ANY_CAMERA } from "../../model/camera.ts";
import { ContainerReader } from "../../packets/container.ts";
import type { Pause } from "../../scheduler.ts";
import { StreamDecoder } from "../decoder.ts";
import type { Splats } from "../splats.ts";

const SECTION = "update",
  VERSION = 1,
  DIGEST_BYTES = 32,
  /** Gaussians of a group, and groups of a larger group, in the list of removed ones. */
  GROUP = 16,
  GROUPS = 16;

/** Decoded update. */
export interface SceneUpdate {
  /** SHA-256 of the manifest of the scene that the update changes, and of the changed scene, hexadecimal. */
  readonly baseDigest: string;
  readonly resultDigest: string;
  /** Serialised list of the removed Gaussians. */
  readonly removed: Uint8Array;
  /** Header of the side information, which has the quantisation steps, hexadecimal. */
  readonly header: string;
  /** New Gaussians. */
  readonly splats: readonly Splats[];
}

/** Returns the header of the side information of explicit Gaussians, hexadecimal. */
export const headerOf = (sideInfo: Uint8Array): string => hex(new ByteReader(sideInfo, "side information").blob());

/**
 * Decodes the file of an update. Throws `BitstreamError` if it is damaged, if packets are missing, or if it is no
 * update.
 */
export async function readUpdate(file: Uint8Array, pause: Pause): Promise<SceneUpdate> {
  const container = new ContainerReader(),
    packets = container.feed(file),
    { head } = container;
  if (!head) throw new BitstreamError("the update is cut");
  if (head.manifest.codec !== "update") throw new BitstreamError("it is not an update");
  const decoder = new StreamDecoder(head, { keptBytes: 0 }, true),
    splats: Splats[] = [];
  for (const bytes of packets) {
    const batch = decoder.addPacket(bytes);
    if (batch) splats.push(batch.forCamera(ANY_CAMERA).splats);
    await pause();
  }
  if (!decoder.intake.complete) throw new BitstreamError("packets of the update are missing");
  if ((await decoder.digest(pause)) !== head.manifest.symbolsDigest) throw new BitstreamError("the update is damaged");
  return { ...readFields(decoder.elementDecoder.sections.get(SECTION)), header: headerOf(head.sideInfo), splats };
}

/** Reads the named section of an update. */
function readFields(section: Uint8Array | undefined): Pick<SceneUpdate, "baseDigest" | "resultDigest" | "removed"> {
  if (!section) throw new BitstreamError(`the update has no section '${SECTION}'`);
  const reader = new ByteReader(section, "update"),
    version = reader.u8();
  if (version !== VERSION) throw new BitstreamError(`the update has version ${version}, this version reads ${VERSION}`);
  const baseDigest = hex(reader.take(DIGEST_BYTES)),
    resultDigest = hex(reader.take(DIGEST_BYTES));
  reader.blob(); // the program that wrote the changed stream
  return { baseDigest, resultDigest, removed: reader.rest() };
}

/**
 * Reads the mask of removed Gaussians, 1 for removed ones, for `count` Gaussians along the Morton curve. Throws
 * `BitstreamError` if the bytes are cut or more bytes follow.
 */
export function readRemoved(bytes: Uint8Array, count: number): Uint8Array {
  const reader = new ByteReader(bytes, "removed Gaussians"),
    larger = readBits(reader, Math.ceil(count / (GROUPS * GROUP))),
    some = readBits(reader, GROUPS * sumOf(larger)),
    full = readBits(reader, sumOf(some)),
    mixed = readBits(reader, GROUP * (full.length - sumOf(full))),
    removed = new Uint8Array(larger.length * GROUPS * GROUP);
  reader.finish();
  let inner = 0,
    group = 0,
    bit = 0;
  for (let first = 0; first < larger.length; first++) {
    if (!larger[first]) continue;
    for (let at = first * GROUPS * GROUP, k = 0; k < GROUPS; k++, at += GROUP) {
      if (!some[inner++]) continue;
      if (full[group++]) removed.fill(1, at, at + GROUP);
      else removed.set(mixed.subarray(bit, (bit += GROUP)), at);
    }
  }
  return removed.subarray(0, count);
}

function readBits(reader: ByteReader, count: number): Uint8Array {
  const coder = new RangeDecoder(reader.blob()),
    model = new Int32Array(2).fill(32768);
  return Uint8Array.from({ length: count }, () => coder.bit(model, 0));
}

const sumOf = (bits: Uint8Array): number => bits.reduce((sum, bit) => sum + bit, 0);
