// Explicit Gaussians: every camera sees the same.

import { type Concealer, grown, SPLAT_CONCEALERS } from "../../conceal/conceal.ts";
import type { Elements } from "../../conceal/elements.ts";
import { sceneFree } from "../../conceal/scene_free.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../turns.ts";
import { LOOKED_AT_BYTES } from "../memory.ts";
import type { Copies } from "../part.ts";
import type { Schema } from "../schema.ts";
import { chosen, splatBytes } from "../splats.ts";
import { type GaussianCopies, readCopies } from "./copies.ts";
import { symbolsDigest } from "./digest.ts";
import { expectedElements } from "./expected.ts";
import { PacketDecoder } from "./packet.ts";
import { GaussianPart } from "./part.ts";
import { readSideInfo, type SideInfo } from "./side_info.ts";
import { toSplats } from "./to_splats.ts";

export class GaussianSchema implements Schema<GaussianPart> {
  readonly lookedAtBytes = LOOKED_AT_BYTES;
  readonly tiling = null;
  readonly viewDependent = false;
  readonly moving = null;
  readonly middle = null;
  readonly concealers: Readonly<Record<string, Concealer>>;
  readonly info: SideInfo;
  readonly #packets: PacketDecoder;
  #copies: GaussianCopies | null = null;

  constructor(
    sideInfo: Uint8Array,
    readonly plan: Plan,
  ) {
    this.info = readSideInfo(sideInfo, plan.numBlocks);
    this.#packets = new PacketDecoder(this.info);
    if (this.info.sections.has("sketch")) this.#readCopies(); // damaged ones are refused at once, as Python does
    const sketch = grown((elements, pause) => sceneFree(elements, pause, this.#readCopies().growth));
    this.concealers = this.info.sections.has("sketch") ? { ...SPLAT_CONCEALERS, sketch } : SPLAT_CONCEALERS;
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

  bytesOf(packet: Packet): number {
    return packet.count * splatBytes(this.degree);
  }

  read(packet: Packet): GaussianPart {
    const splats = toSplats(this.#packets.decode(packet.payload, packet.block, packet.count), this.info, packet.block);
    return new GaussianPart(packet, splats, () => this.plan.members(packet));
  }

  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    return symbolsDigest(blocks, pause, (packet) => this.#packets.decode(packet.payload, packet.block, packet.count));
  }

  copies(): Promise<Copies<GaussianPart>> {
    const { places, splats } = this.#readCopies(),
      some = (which: Int32Array): Int32Array => which.map((n) => places[n]);
    return Promise.resolve({
      part: new GaussianPart(null, splats, () => places),
      chosen: (which) => new GaussianPart(null, chosen(splats, which), () => some(which)),
    });
  }

  #readCopies(): GaussianCopies {
    return (this.#copies ??= readCopies(this.info.sections.get("sketch")!, this.info, this.plan.manifest.count));
  }

  elements(parts: readonly GaussianPart[]): Promise<Elements> {
    return Promise.resolve(expectedElements(this.info, this.plan, parts));
  }
}
