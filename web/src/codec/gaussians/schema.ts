// Explicit Gaussians: every camera sees the same.

import { SPLAT_CONCEALERS, type Elements } from "../../conceal/conceal.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Part, Schema, Seen } from "../schema.ts";
import type { Splats } from "../splats.ts";
import { symbolsDigest } from "./digest.ts";
import { expectedElements } from "./expected.ts";
import { PacketDecoder } from "./packet.ts";
import { readSideInfo, type SideInfo } from "./side_info.ts";
import { toSplats } from "./to_splats.ts";

export class GaussianPart implements Part {
  constructor(readonly packet: Packet, readonly splats: Splats) {}

  get count(): number {
    return this.splats.count;
  }

  seen(): Seen {
    return { splats: this.splats, owners: null };
  }
}

export class GaussianSchema implements Schema<GaussianPart> {
  readonly viewDependent = false;
  readonly middle = null;
  readonly concealers = SPLAT_CONCEALERS;
  readonly info: SideInfo;
  readonly #packets: PacketDecoder;

  constructor(sideInfo: Uint8Array, readonly plan: Plan) {
    this.info = readSideInfo(sideInfo, plan.numBlocks);
    this.#packets = new PacketDecoder(this.info);
  }

  get degree(): number {
    return this.info.degree;
  }

  get size(): number {
    return 2 ** this.info.sizeLog;
  }

  get sections(): Map<string, Uint8Array> {
    return this.info.sections;
  }

  read(packet: Packet): GaussianPart {
    return new GaussianPart(packet, toSplats(this.#packets.decode(packet.payload, packet.block, packet.count), this.info, packet.block));
  }

  digest(blocks: readonly (readonly Packet[])[]): string {
    return symbolsDigest(blocks, (packet) => this.#packets.decode(packet.payload, packet.block, packet.count));
  }

  elements(parts: readonly GaussianPart[]): Promise<Elements> {
    return Promise.resolve(expectedElements(this.info, this.plan, parts));
  }
}
