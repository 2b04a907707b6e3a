// Anchors of the causal codec: decoded packet by packet, drawn by neural heads for each camera.

import { sha256 } from "@noble/hashes/sha2.js";

import { hex } from "../../bytes.ts";
import { ANCHOR_CONCEALERS, type Elements, type Pause } from "../../conceal/conceal.ts";
import type { Anchors } from "../../model/anchors.ts";
import type { Camera } from "../../model/camera.ts";
import { Heads } from "../../model/heads.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Part, Schema, Seen } from "../schema.ts";
import { ranksInOrder } from "../tiers.ts";
import { floatMlp, toAnchors } from "./anchors.ts";
import { Expected, type Arrived } from "./expected.ts";
import { PacketDecoder, type Decoded } from "./packet.ts";
import { readSideInfo, type SideInfo } from "./side_info.ts";

class AnchorPart implements Part, Arrived {
  readonly anchors: Anchors;
  readonly sums: Float64Array;
  readonly squares: Float64Array;
  /** Features, until somebody looks; then what they say to the heads. */
  #features: Float32Array | null;
  #hidden: Float32Array = new Float32Array();

  constructor(readonly packet: Packet, readonly ranks: Int32Array, decoded: Decoded, info: SideInfo, readonly heads: Heads) {
    const { anchors, features } = toAnchors(decoded, info), size = info.features;
    this.anchors = anchors;
    this.#features = features;
    this.sums = new Float64Array(size);
    this.squares = new Float64Array(size);
    for (let n = 0; n < features.length; n++) {
      this.sums[n % size] += features[n];
      this.squares[n % size] += features[n] ** 2;
    }
  }

  get count(): number {
    return this.ranks.length;
  }

  seen(camera: Camera): Seen {
    if (this.#features) this.#hidden = this.heads.prepared(this.#features);
    this.#features = null;
    return this.heads.spawn(this.anchors, this.#hidden, camera);
  }
}

export class CausalSchema implements Schema<AnchorPart> {
  readonly viewDependent = true;
  readonly degree = 0;
  readonly info: SideInfo;
  readonly heads: Heads;
  readonly #packets: PacketDecoder;
  readonly #order: Int32Array | null;
  readonly #expected: Expected;

  constructor(sideInfo: Uint8Array, readonly plan: Plan) {
    this.info = readSideInfo(sideInfo, plan.manifest.count);
    this.#order = ranksInOrder(this.info.sections, plan.manifest);
    const [opacity, covariance, color] = this.info.heads.map(floatMlp);
    this.heads = new Heads(opacity, covariance, color);
    this.#packets = new PacketDecoder(this.info);
    this.#expected = new Expected(this.#packets, plan.manifest.count);
  }

  /** Half of the anchors are about this near to the middle. */
  get size(): number {
    return Math.max(...this.info.spread) * this.info.voxelSize;
  }

  get middle(): number[] {
    return this.info.middle.map((value) => value * this.info.voxelSize);
  }

  readonly concealers = ANCHOR_CONCEALERS;

  get sections(): Map<string, Uint8Array> {
    return this.info.sections;
  }

  read(packet: Packet): AnchorPart {
    const ranks = this.#ranks(packet);
    return new AnchorPart(packet, ranks, this.#packets.decode(packet.payload, ranks), this.info, this.heads);
  }

  /** Places, masks and numbers as 32-bit integers, anchor by anchor. */
  digest(blocks: readonly (readonly Packet[])[]): string {
    const digest = sha256.create(), { offsets } = this.info, { width } = this.#packets;
    for (const packet of blocks.flat()) {
      const { count, places, masks, numbers } = this.#packets.decode(packet.payload, this.#ranks(packet)), bytes = new DataView(new ArrayBuffer(4 * count * (3 + offsets + width)));
      for (let n = 0, at = 0; n < count; n++) {
        for (let a = 0; a < 3; a++, at += 4) bytes.setInt32(at, places[3 * n + a], true);
        for (let k = 0; k < offsets; k++, at += 4) bytes.setInt32(at, masks[n * offsets + k], true);
        for (let c = 0; c < width; c++, at += 4) bytes.setInt32(at, numbers[n * width + c], true);
      }
      digest.update(new Uint8Array(bytes.buffer));
    }
    return hex(digest.digest());
  }

  elements(parts: readonly AnchorPart[], pause: Pause): Promise<Elements | null> {
    return this.#expected.elements(parts, pause);
  }

  #ranks(packet: Packet): Int32Array {
    const places = this.plan.members(packet), order = this.#order;
    return order ? places.map((place) => order[place]) : places;
  }
}
