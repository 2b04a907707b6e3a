// Gaussians in levels of detail. The drawn tiles depend on the view and on the received packets.

import { CONCEALERS } from "../../conceal/conceal.ts";
import type { Camera } from "../../model/camera.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../scheduler.ts";
import type { Copies, ElementBatch, ViewGaussians } from "../element_batch.ts";
import type { ElementDecoder } from "../element_decoder.ts";
import { GaussianDecoder } from "../gaussians/gaussian_decoder.ts";
import { CONCEALMENT_BYTES } from "../memory.ts";
import { emptySplats, type Splats, selectSplats } from "../splats.ts";
import { assignToChildren, BUDGET, type Cut, cutOf } from "./cut.ts";
import { DrawUnits } from "./draw_units.ts";
import { readTiles, type Tiles } from "./tiles.ts";
import type { Tiling } from "./tiling.ts";

/**
 * Share of a tile's packets needed to draw it. Packets are spread evenly over the tile, and missing ones are sent
 * again.
 */
const DRAWABLE_SHARE = 0.75;

/** One packet. It is decoded when drawn and released afterwards. */
class LevelBatch implements ElementBatch {
  #splats: Splats | null = null;
  /** Indices of the Gaussians that represent each child tile. */
  #ofChildren: ReadonlyMap<number, Int32Array> | null = null;

  constructor(
    readonly packet: Packet,
    readonly elementDecoder: LevelDecoder,
  ) {}

  get count(): number {
    return this.packet.count;
  }

  get indices(): Int32Array {
    return this.elementDecoder.gaussianDecoder.plan.members(this.packet);
  }

  /** Returns the indices of the Gaussians that represent a child tile; all if `child` is null. */
  which(child: number | null, splats?: Splats): Int32Array {
    if (child === null) return Int32Array.from({ length: this.count }, (_, n) => n);
    this.#ofChildren ??= this.#grouped((splats ?? this.splats).means);
    return this.#ofChildren.get(child) ?? new Int32Array();
  }

  /** Groups Gaussians by child tile once, because a tile may have thousands of children. */
  #grouped(means: Float32Array): Map<number, Int32Array> {
    const found = new Map<number, number[]>();
    assignToChildren(this.elementDecoder.tiles, this.packet.block, means).forEach((child, n) => {
      const some = found.get(child);
      if (some) some.push(n);
      else found.set(child, [n]);
    });
    return new Map([...found].map(([child, some]) => [child, Int32Array.from(some)]));
  }

  get splats(): Splats {
    return this.elementDecoder.gaussianDecoder.read(this.packet).splats;
  }

  forCamera(): ViewGaussians {
    const drawn = this.elementDecoder.drawnChildren(this.packet.block);
    if (!drawn.length) {
      this.#splats = null;
      return { splats: this.elementDecoder.noGaussians, owners: new Int32Array() };
    }
    const splats = (this.#splats ??= this.splats),
      owners = Int32Array.from(drawn.flatMap((child) => [...this.which(child, splats)]));
    return { splats: owners.length === this.count ? splats : selectSplats(splats, owners), owners };
  }
}

export class LevelDecoder implements ElementDecoder<LevelBatch>, Tiling {
  readonly concealmentBytes = CONCEALMENT_BYTES;
  readonly tiling = this;
  readonly viewDependent = true;
  readonly sequence = null;
  /**
   * Coarser tiles replace lost ones: a tile is drawn once most of it was received. No further concealment is needed.
   */
  readonly concealers = { drop: CONCEALERS.drop };
  readonly gaussianDecoder: GaussianDecoder;
  readonly tiles: Tiles;
  readonly noGaussians: Splats;
  readonly #receivedPackets: Int32Array;
  readonly #batches: LevelBatch[][];
  readonly drawUnits: DrawUnits;
  #cut: Cut = { drawn: [], wanted: [] };
  #drawn = new Set<number>();
  /** The coarser tile decoded last, cached because its units are requested one after another. */
  budget = BUDGET;
  #cachedTile: { readonly tile: number; readonly splats: readonly Splats[] } | null = null;

  constructor(sideInfo: Uint8Array, plan: Plan) {
    this.gaussianDecoder = new GaussianDecoder(sideInfo, plan);
    this.tiles = readTiles(this.gaussianDecoder.info, plan);
    this.drawUnits = new DrawUnits(this.tiles);
    this.#receivedPackets = new Int32Array(this.tiles.count);
    this.#batches = Array.from({ length: this.tiles.count }, () => []);
    this.noGaussians = emptySplats(0, this.degree);
    this.setCamera(null);
  }

  get degree(): number {
    return this.gaussianDecoder.degree;
  }

  get size(): number {
    return this.gaussianDecoder.size;
  }

  get sections(): Map<string, Uint8Array> {
    return this.gaussianDecoder.sections;
  }

  /** Number of Gaussians in all levels but the finest, enough for a first view. */
  get baseCount(): number {
    const { numGaussians, errors } = this.tiles;
    return numGaussians.reduce((sum, count, tile) => sum + (errors[tile] > 0 ? count : 0), 0);
  }

  /** Mean of the coarsest tiles' centres, world units. */
  get middle(): readonly number[] {
    const { low, high } = this.tiles,
      roots = this.framingBlocks;
    return [0, 1, 2].map((a) => {
      let sum = 0;
      for (let root = 0; root < roots; root++) sum += (low[3 * root + a] + high[3 * root + a]) / 2;
      return sum / roots;
    });
  }

  get framingBlocks(): number {
    return this.tiles.parents.filter((parent) => parent < 0).length;
  }

  get wanted(): readonly number[] {
    return this.#cut.wanted;
  }

  get drawn(): readonly number[] {
    return [...this.#drawn];
  }

  packetsOf(unit: number): number {
    return this.#batches[this.drawUnits.of(unit).tile].length;
  }

  batchesOf(unit: number): { batch: LevelBatch; which: Int32Array }[] {
    const { tile, child } = this.drawUnits.of(unit);
    return this.#batches[tile].map((batch) => ({ batch, which: batch.which(child) }));
  }

  splatsOf(unit: number): Splats[] {
    const { tile, child } = this.drawUnits.of(unit),
      batches = this.#batches[tile];
    if (child === null) return batches.map((batch) => batch.splats);
    const isCached = this.#cachedTile?.tile === tile && this.#cachedTile.splats.length === batches.length;
    if (!isCached) this.#cachedTile = { tile, splats: batches.map((batch) => batch.splats) };
    return this.#cachedTile!.splats.map((splats, n) => selectSplats(splats, batches[n].which(child, splats)));
  }

  /** Returns the child tiles that a tile's Gaussians represent. The only entry is null for a finest tile. */
  drawnChildren(tile: number): (number | null)[] {
    const { children, count } = this.tiles;
    if (!children[tile].length) return this.#drawn.has(count + tile) ? [null] : [];
    return children[tile].filter((child) => this.#drawn.has(child));
  }

  setCamera(camera: Camera | null, budget = this.budget): boolean {
    const { numPackets, parents } = this.tiles,
      received = this.#receivedPackets,
      isComplete = (tile: number): boolean => received[tile] === numPackets[tile],
      isDrawable = (tile: number): boolean =>
        received[tile] >= (parents[tile] < 0 ? 1 : DRAWABLE_SHARE * numPackets[tile]);
    this.#cut = cutOf(this.tiles, isComplete, camera, budget, isDrawable);
    const drawn = this.drawUnits.drawn(this.#cut),
      isUnchanged = drawn.length === this.#drawn.size && drawn.every((unit) => this.#drawn.has(unit));
    if (!isUnchanged) this.#drawn = new Set(drawn);
    return !isUnchanged;
  }

  bytesOf(packet: Packet): number {
    return this.gaussianDecoder.bytesOf(packet);
  }

  read(packet: Packet): LevelBatch {
    const batch = new LevelBatch(packet, this);
    this.#receivedPackets[packet.block]++;
    this.#batches[packet.block].push(batch);
    return batch;
  }

  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    return this.gaussianDecoder.digest(blocks, pause);
  }

  copies(): Promise<Copies<LevelBatch> | null> {
    return Promise.resolve(null);
  }

  elements(): Promise<null> {
    return Promise.resolve(null);
  }
}
