// Clips: tracks of Gaussians over groups of frames. This decoder decodes keyframe Gaussians; `Sequence` decodes their
// motion.

import type { Elements } from "../../conceal/elements.ts";
import { type Packet, withoutBytes } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../scheduler.ts";
import { newSha256 } from "../../sha256.ts";
import type { Copies } from "../element_batch.ts";
import type { DecodedPacket, ElementDecoder } from "../element_decoder.ts";
import { addRows, integers32 } from "../gaussians/digest.ts";
import { GaussianBatch } from "../gaussians/gaussian_batch.ts";
import { compressFast, FastPacketDecoder } from "../gaussians/native.ts";
import type { Decoded } from "../gaussians/packet.ts";
import { toSplats } from "../gaussians/to_splats.ts";
import { CONCEALMENT_BYTES } from "../memory.ts";
import { emptySplats, splatBytes } from "../splats.ts";
import { TRACK_BYTES } from "./keyframe_gaussians.ts";
import { decodeMotion } from "./motion.ts";
import { Sequence } from "./sequence.ts";
import { readSequenceInfo, type SequenceInfo, shotOf } from "./side_info.ts";

/** First block of a group's keyframe Gaussians, among all of them and in the plan, and the group's first track. */
interface FirstOfGroup {
  readonly keyframeBlock: number;
  readonly planBlock: number;
  readonly firstTrack: number;
}

function firstsOf({ groups }: SequenceInfo, plan: Plan): FirstOfGroup[] {
  const size = plan.manifest.packetization.blockSize;
  let keyframeBlock = 0,
    planBlock = 0;
  return groups.map(({ numBirths, numMotionTracks, firstNew }) => {
    const found = { keyframeBlock, planBlock, firstTrack: firstNew };
    keyframeBlock += Math.ceil(numBirths / size);
    planBlock += Math.ceil(numBirths / size) + Math.ceil(numMotionTracks / size);
    return found;
  });
}

export class TrackDecoder implements ElementDecoder<GaussianBatch> {
  readonly concealmentBytes = CONCEALMENT_BYTES;
  readonly tiling = null;
  readonly viewDependent = false;
  readonly middle = null;
  info: SequenceInfo;
  readonly concealers = {};
  /** Received packets and frames of the clip. */
  readonly sequence: Sequence;
  /** Decoder of the keyframe Gaussians of one shot. Packets of a file, and those of a server, are in order of shots. */
  readonly #keyframeDecoder: FastPacketDecoder;
  #firsts: readonly FirstOfGroup[];

  constructor(
    sideInfo: Uint8Array,
    public plan: Plan,
  ) {
    this.info = readSequenceInfo(sideInfo, plan.manifest);
    this.sequence = new Sequence(this.info, sideInfo.length);
    this.#keyframeDecoder = new FastPacketDecoder(this.info.keyframeInfo);
    this.#firsts = firstsOf(this.info, plan);
  }

  grow(sideInfo: Uint8Array, plan: Plan): void {
    this.info = readSequenceInfo(sideInfo, plan.manifest);
    this.plan = plan;
    this.sequence.grow(this.info);
    this.#firsts = firstsOf(this.info, plan);
  }

  get degree(): number {
    return this.info.keyframeInfo.degree;
  }

  get size(): number {
    return 2 ** this.info.keyframeInfo.sizeLog;
  }

  get sections(): Map<string, Uint8Array> {
    return this.info.sections;
  }

  get framingBlocks(): number {
    return this.plan.tiers.find(({ numBlocks }) => numBlocks)?.numBlocks ?? 0; // keyframes of the first group with any
  }

  /** Memory of decoded keyframe Gaussians, bytes. Motion is decoded later and has its own limit. */
  bytesOf(packet: Packet): number {
    return this.plan.isKeyframe(packet.block) ? packet.count * (splatBytes(this.degree) + TRACK_BYTES) : 0;
  }

  read(packet: Packet): GaussianBatch {
    const decoded = this.decode(packet);
    if (decoded) return this.accept(packet, decoded);
    this.sequence.addMotion(this.plan.gopOf(packet.block), packet);
    // sequence and intake keep the bytes until the motion is forgotten
    return new GaussianBatch(withoutBytes(packet), emptySplats(0, this.degree), () => new Int32Array());
  }

  /** Decodes a packet of keyframe Gaussians. Motion is decoded when it is drawn, because it needs them. */
  decode({ payload, block, count }: Packet): DecodedPacket | null {
    if (!this.plan.isKeyframe(block)) return null;
    const keyframeBlock = this.#keyframeBlock(block),
      shot = shotOf(this.info, keyframeBlock),
      symbols = this.#decode(payload, keyframeBlock, count);
    return { symbols, splats: toSplats(symbols, shot.keyframeInfo, keyframeBlock - shot.firstBlock) };
  }

  /** Returns the index of a block of the plan among all blocks of keyframe Gaussians. */
  #keyframeBlock(block: number): number {
    const { keyframeBlock, planBlock } = this.#firsts[this.plan.gopOf(block)];
    return keyframeBlock + block - planBlock;
  }

  #decode(payload: Uint8Array, keyframeBlock: number, count: number): Decoded {
    const { firstBlock, keyframeInfo } = shotOf(this.info, keyframeBlock);
    if (this.#keyframeDecoder.info !== keyframeInfo) this.#keyframeDecoder.setInfo(keyframeInfo);
    return this.#keyframeDecoder.decode(payload, keyframeBlock - firstBlock, count);
  }

  accept(packet: Packet, { symbols, splats }: DecodedPacket): GaussianBatch {
    const group = this.plan.gopOf(packet.block),
      { planBlock, firstTrack } = this.#firsts[group],
      block = packet.block - planBlock,
      first = firstTrack + block * (block ? this.plan.numElementsOf(planBlock) : 0) + packet.indexInBlock;
    this.sequence.addKeyframes(group, first, symbols.rows, this.#keyframeBlock(packet.block), splats);
    this.sequence.numBytes += packet.payload.length;
    return new GaussianBatch(packet, splats, () => this.plan.members(packet));
  }

  /** Digest of the integers of keyframe Gaussians and of motion, block by block. */
  async digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    const digest = newSha256(compressFast);
    for (const packets of blocks) {
      const found: Decoded[] = [],
        motionArrays: Int32Array[][] = [[], []];
      for (const packet of packets) {
        await pause();
        if (this.plan.isKeyframe(packet.block)) {
          found.push(this.#decode(packet.payload, this.#keyframeBlock(packet.block), packet.count));
        } else {
          const { headers, residuals } = this.#motion(packet, this.plan.gopOf(packet.block));
          motionArrays[0].push(headers);
          motionArrays[1].push(residuals);
        }
      }
      addRows(digest, found);
      for (const arrays of motionArrays) for (const values of arrays) digest.update(integers32(values));
    }
    return digest.hex();
  }

  #motion(packet: Packet, group: number): ReturnType<typeof decodeMotion> {
    const { groups, models } = this.info;
    return decodeMotion(packet.payload, models, packet.count, this.sequence.framesOf(group), groups[group].firstNew);
  }

  copies(): Promise<Copies<GaussianBatch> | null> {
    return Promise.resolve(null);
  }

  elements(): Promise<Elements | null> {
    return Promise.resolve(null);
  }
}
