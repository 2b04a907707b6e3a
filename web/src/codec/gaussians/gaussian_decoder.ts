// Explicit Gaussians, which do not depend on the camera.

import { type Concealer, fromElements, SPLAT_CONCEALERS } from "../../conceal/conceal.ts";
import type { Elements } from "../../conceal/elements.ts";
import { sceneFree } from "../../conceal/scene_free.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../scheduler.ts";
import type { Copies } from "../element_batch.ts";
import type { DecodedPacket, ElementDecoder } from "../element_decoder.ts";
import { allowedMemory, CONCEALMENT_BYTES } from "../memory.ts";
import { emptySplats, type Splats, selectSplats, splatBytes, subSplats } from "../splats.ts";
import { SymbolsDigest, type Verification } from "./digest.ts";
import { GaussianBatch } from "./gaussian_batch.ts";
import { FastPacketDecoder } from "./native.ts";
import type { Decoded, GaussianPacketDecoder } from "./packet.ts";
import { predictedElements } from "./predicted.ts";
import { type RedundantGaussians, readRedundantGaussians } from "./redundant_copies.ts";
import { readSideInfo, type SideInfo } from "./side_info.ts";
import { toSplats } from "./to_splats.ts";

export class GaussianDecoder implements ElementDecoder<GaussianBatch> {
  readonly concealmentBytes = CONCEALMENT_BYTES;
  readonly tiling = null;
  readonly viewDependent = false;
  readonly sequence = null;
  readonly middle = null;
  readonly concealers: Readonly<Record<string, Concealer>>;
  readonly info: SideInfo;
  readonly #packetDecoder: GaussianPacketDecoder;
  readonly #keptBytes: number;
  #copies: RedundantGaussians | null = null;
  /** Digest of the packets decoded so far; null if it is only computed on demand. */
  #digest: SymbolsDigest | null;
  /**
   * Arrays of all Gaussians of a file, which packets fill one after another, and the number of Gaussians so far. Null
   * if packets are decoded as they arrive.
   */
  readonly #preallocated: Splats | null;
  #filled = 0;

  /** `fileBytes`: see `StreamDecoder`. */
  constructor(
    sideInfo: Uint8Array,
    readonly plan: Plan,
    verify: Verification = null,
  ) {
    const fileBytes = verify?.fileBytes ?? 0;
    this.#keptBytes = verify?.keptBytes ?? 0;
    this.#digest = verify && new SymbolsDigest(this.#keptBytes);
    this.info = readSideInfo(sideInfo, plan.numBlocks);
    const { count } = plan.manifest,
      fits = fileBytes > 0 && count * splatBytes(this.degree) <= allowedMemory(fileBytes);
    this.#preallocated = fits ? emptySplats(count, this.degree) : null;
    this.#packetDecoder = new FastPacketDecoder(this.info);
    if (this.info.sections.has("sketch")) this.#readCopies(); // throws at once if copies are damaged, as Python does
    const sketch = fromElements((elements, pause) => sceneFree(elements, pause, this.#readCopies().growth));
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

  read(packet: Packet): GaussianBatch {
    if (this.#keptBytes) return this.accept(packet, this.decode(packet));
    const symbols = this.#decode(packet, true),
      splats = toSplats(symbols, this.info, packet.block, this.#splatsFor(packet.count));
    return this.accept(packet, { symbols, splats });
  }

  /** Decodes a packet to new arrays. */
  decode(packet: Packet): DecodedPacket {
    const symbols = this.#decode(packet);
    return { symbols, splats: toSplats(symbols, this.info, packet.block) };
  }

  accept(packet: Packet, { symbols, splats }: DecodedPacket): GaussianBatch {
    this.#digest?.add(packet, symbols);
    return new GaussianBatch(packet, splats, () => this.plan.members(packet));
  }

  /** Returns zeros for the Gaussians of the next packet. */
  #splatsFor(count: number): Splats {
    const first = this.#filled;
    if (!this.#preallocated || first + count > this.#preallocated.count) return emptySplats(count, this.degree);
    this.#filled += count;
    return subSplats(this.#preallocated, first, count);
  }

  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    const digest = this.#digest ?? new SymbolsDigest();
    this.#digest = null;
    return digest.finish(blocks, pause, (packet) => this.#decode(packet));
  }

  /** Decodes a packet. The next call may overwrite the result if it is `mayReuse`. */
  #decode({ payload, block, count }: Packet, mayReuse = false): Decoded {
    return this.#packetDecoder.decode(payload, block, count, mayReuse, false);
  }

  copies(): Promise<Copies<GaussianBatch>> {
    const { indices, splats } = this.#readCopies(),
      some = (which: Int32Array): Int32Array => which.map((n) => indices[n]);
    return Promise.resolve({
      batch: new GaussianBatch(null, splats, () => indices),
      select: (which) => new GaussianBatch(null, selectSplats(splats, which), () => some(which)),
    });
  }

  #readCopies(): RedundantGaussians {
    return (this.#copies ??= readRedundantGaussians(
      this.info.sections.get("sketch")!,
      this.info,
      this.plan.manifest.count,
    ));
  }

  elements(batches: readonly GaussianBatch[]): Promise<Elements> {
    return Promise.resolve(predictedElements(this.info, this.plan, batches));
  }
}
