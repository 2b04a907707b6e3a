// Anchors of the causal codec, which neural heads turn into the Gaussians of a view.

import { ANCHOR_CONCEALERS, type Concealer, fromElements } from "../../conceal/conceal.ts";
import type { Elements } from "../../conceal/elements.ts";
import { grow } from "../../conceal/grow.ts";
import { sceneFreeAnchors } from "../../conceal/scene_free_anchors.ts";
import { Heads } from "../../model/heads.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import { SKETCH } from "../../packets/section_names.ts";
import type { Pause } from "../../scheduler.ts";
import { newSha256 } from "../../sha256.ts";
import { AnchorBatch, type AnchorData, selectAnchors } from "../anchor_batch.ts";
import type { Copies } from "../element_batch.ts";
import type { ElementDecoder } from "../element_decoder.ts";
import { tierLayout } from "../tiers.ts";
import { AnchorPrediction, type ReceivedAnchors } from "./anchor_prediction.ts";
import { floatMlp, toAnchors } from "./anchors.ts";
import { PacketDecoder } from "./packet.ts";
import { type RedundantAnchors, readRedundantAnchors } from "./redundant_copies.ts";
import { readSideInfo, type SideInfo } from "./side_info.ts";

/** Anchors of a packet with the statistics of their features. */
class CausalBatch extends AnchorBatch implements ReceivedAnchors {
  readonly sums: Float64Array;
  readonly squares: Float64Array;

  constructor(packet: Packet | null, ranks: Int32Array, known: AnchorData, heads: Heads) {
    super(packet, ranks, known, heads);
    const { features } = known,
      size = features.length / Math.max(known.anchors.count, 1);
    this.sums = new Float64Array(size);
    this.squares = new Float64Array(size);
    for (let n = 0; n < features.length; n++) {
      this.sums[n % size] += features[n];
      this.squares[n % size] += features[n] ** 2;
    }
  }
}

export class CausalDecoder implements ElementDecoder<CausalBatch> {
  readonly tiling = null;
  readonly viewDependent = true;
  readonly sequence = null;
  readonly degree = 0;
  readonly info: SideInfo;
  readonly heads: Heads;
  readonly #packetDecoder: PacketDecoder;
  readonly #order: Int32Array | null;
  readonly #prediction: AnchorPrediction;
  #sketch: RedundantAnchors | null = null;

  constructor(
    sideInfo: Uint8Array,
    readonly plan: Plan,
  ) {
    this.info = readSideInfo(sideInfo, plan.manifest.count);
    const tiers = tierLayout(this.info.sections, plan.manifest);
    this.#order = tiers.order;
    const [opacity, covariance, color] = this.info.heads.map(floatMlp);
    this.heads = new Heads(opacity, covariance, color);
    this.#packetDecoder = new PacketDecoder(this.info);
    this.#prediction = new AnchorPrediction(this.#packetDecoder, plan.manifest.count, tiers.sizes);
  }

  /** Size of the scene, world units. About half of the anchors are within this distance of the centre. */
  get size(): number {
    return Math.max(...this.info.spread) * this.info.voxelSize;
  }

  get middle(): number[] {
    return this.info.middle.map((value) => value * this.info.voxelSize);
  }

  get concealers(): Readonly<Record<string, Concealer>> {
    return this.info.sections.has(SKETCH)
      ? { ...ANCHOR_CONCEALERS, sketch: fromElements(this.#sketched) }
      : ANCHOR_CONCEALERS;
  }

  readonly #sketched = (elements: Elements, pause: Pause): Promise<Float32Array | null> => {
    const { rule, trust } = this.#sketch!;
    return trust ? sceneFreeAnchors(elements, pause, rule, trust) : grow(elements, pause, rule);
  };

  get sections(): Map<string, Uint8Array> {
    return this.info.sections;
  }

  get concealmentBytes(): number {
    return this.#prediction.bytes;
  }

  bytesOf(packet: Packet): number {
    return packet.count * this.heads.anchorBytes(this.info.offsets);
  }

  read(packet: Packet): CausalBatch {
    const ranks = this.#ranks(packet);
    return new CausalBatch(
      packet,
      ranks,
      toAnchors(this.#packetDecoder.decode(packet.payload, ranks), this.info),
      this.heads,
    );
  }

  /** Digest of positions, masks and numbers as 32-bit integers, anchor by anchor. */
  async digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    const digest = newSha256(),
      { offsets } = this.info,
      { width } = this.#packetDecoder;
    for (const packet of blocks.flat()) {
      await pause();
      const { count, voxels, masks, values } = this.#packetDecoder.decode(packet.payload, this.#ranks(packet)),
        bytes = new DataView(new ArrayBuffer(4 * count * (3 + offsets + width)));
      for (let n = 0, at = 0; n < count; n++) {
        for (let a = 0; a < 3; a++, at += 4) bytes.setInt32(at, voxels[3 * n + a], true);
        for (let k = 0; k < offsets; k++, at += 4) bytes.setInt32(at, masks[n * offsets + k], true);
        for (let c = 0; c < width; c++, at += 4) bytes.setInt32(at, values[n * width + c], true);
      }
      digest.update(new Uint8Array(bytes.buffer));
    }
    return digest.hex();
  }

  async copies(pause: Pause): Promise<Copies<CausalBatch> | null> {
    const { features, offsets } = this.info,
      lengths = await this.#prediction.lengths(pause),
      { count } = this.plan.manifest;
    if (!lengths) return null;
    const positions = (ranks: Int32Array): Float32Array => this.#prediction.positions(ranks);
    const sketch = (this.#sketch ??= readRedundantAnchors(this.info.sections.get(SKETCH)!, {
      count,
      features,
      offsets,
      lengths,
      positions,
    }));
    const batch = (which: Int32Array): CausalBatch =>
      new CausalBatch(
        null,
        which.map((n) => sketch.ranks[n]),
        selectAnchors(sketch, which),
        this.heads,
      );
    return { batch: batch(sketch.ranks.map((_, n) => n)), select: batch };
  }

  elements(batches: readonly CausalBatch[], pause: Pause): Promise<Elements | null> {
    return this.#prediction.elements(batches, pause);
  }

  #ranks(packet: Packet): Int32Array {
    const indices = this.plan.members(packet),
      order = this.#order;
    return order ? indices.map((index) => order[index]) : indices;
  }
}
