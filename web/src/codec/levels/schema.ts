// Gaussians in levels: what is drawn depends on where somebody looks from, and on what is there.

import { CONCEALERS } from "../../conceal/conceal.ts";
import type { Camera } from "../../model/camera.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../turns.ts";
import { GaussianSchema } from "../gaussians/schema.ts";
import { LOOKED_AT_BYTES } from "../memory.ts";
import type { Copies, Part, Seen } from "../part.ts";
import type { Schema } from "../schema.ts";
import { chosen, emptySplats, type Splats } from "../splats.ts";
import { BUDGET, type Cut, cutOf, standsFor } from "./cut.ts";
import { Pieces } from "./pieces.ts";
import { readTiles, type Tiles } from "./tiles.ts";
import type { Tiling } from "./tiling.ts";

/** Share of a tile's packets with which it is drawn: they lie evenly over it, and what is lost comes again. */
const MOST = 0.75;

/** A packet; decoded when it is drawn, and forgotten when it is not any more. */
class LevelPart implements Part {
  #splats: Splats | null = null;
  #instead: Int32Array | null = null;

  constructor(
    readonly packet: Packet,
    readonly schema: LevelSchema,
  ) {}

  get count(): number {
    return this.packet.count;
  }

  get places(): Int32Array {
    return this.schema.gaussians.plan.members(this.packet);
  }

  /** Which of its Gaussians stand for a finer tile; all where there is none. */
  which(instead: number | null, splats?: Splats): Int32Array {
    const all = Int32Array.from({ length: this.count }, (_, n) => n);
    if (instead === null) return all;
    const { tiles } = this.schema;
    this.#instead ??= standsFor(tiles, this.packet.block, (splats ?? this.decoded()).means);
    return all.filter((n) => this.#instead![n] === instead);
  }

  decoded(): Splats {
    return this.schema.gaussians.read(this.packet).splats;
  }

  seen(): Seen {
    const drawn = this.schema.drawnOf(this.packet.block);
    if (!drawn.length) {
      this.#splats = null;
      return { splats: this.schema.none, owners: new Int32Array() };
    }
    const splats = (this.#splats ??= this.decoded()),
      owners = Int32Array.from(drawn.flatMap((instead) => [...this.which(instead, splats)]));
    return { splats: owners.length === this.count ? splats : chosen(splats, owners), owners };
  }
}

export class LevelSchema implements Schema<LevelPart>, Tiling {
  readonly lookedAtBytes = LOOKED_AT_BYTES;
  readonly tiling = this;
  readonly viewDependent = true;
  readonly moving = null;
  /** Losses are hidden by coarser tiles: a finer one is drawn when most of it is there. */
  readonly concealers = { drop: CONCEALERS.drop };
  readonly gaussians: GaussianSchema;
  readonly tiles: Tiles;
  readonly none: Splats;
  readonly #came: Int32Array;
  readonly #parts: LevelPart[][];
  readonly pieces: Pieces;
  #cut: Cut = { drawn: [], wanted: [] };
  #drawn = new Set<number>();
  /** The last coarser tile that was decoded: its pieces are asked for one after another. */
  #recent: { readonly tile: number; readonly splats: readonly Splats[] } | null = null;

  constructor(sideInfo: Uint8Array, plan: Plan) {
    this.gaussians = new GaussianSchema(sideInfo, plan);
    this.tiles = readTiles(this.gaussians.info, plan);
    this.pieces = new Pieces(this.tiles);
    this.#came = new Int32Array(this.tiles.count);
    this.#parts = Array.from({ length: this.tiles.count }, () => []);
    this.none = emptySplats(0, this.degree);
    this.look(null);
  }

  get degree(): number {
    return this.gaussians.degree;
  }

  get size(): number {
    return this.gaussians.size;
  }

  get sections(): Map<string, Uint8Array> {
    return this.gaussians.sections;
  }

  /** Gaussians that are enough to look around: those of all levels but the finest. */
  get enough(): number {
    const { gaussians, errors } = this.tiles;
    return gaussians.reduce((sum, count, tile) => sum + (errors[tile] > 0 ? count : 0), 0);
  }

  /** Middle of the coarsest tiles. */
  get middle(): readonly number[] {
    const { low, high, parents } = this.tiles,
      roots = parents.filter((parent) => parent < 0).length;
    return [0, 1, 2].map((a) => {
      let sum = 0;
      for (let root = 0; root < roots; root++) sum += (low[3 * root + a] + high[3 * root + a]) / 2;
      return sum / roots;
    });
  }

  get wanted(): readonly number[] {
    return this.#cut.wanted;
  }

  get drawn(): readonly number[] {
    return [...this.#drawn];
  }

  packetsOf(piece: number): number {
    return this.#parts[this.pieces.of(piece).tile].length;
  }

  partsOf(piece: number): { part: LevelPart; which: Int32Array }[] {
    const { tile, instead } = this.pieces.of(piece);
    return this.#parts[tile].map((part) => ({ part, which: part.which(instead) }));
  }

  splatsOf(piece: number): Splats[] {
    const { tile, instead } = this.pieces.of(piece),
      parts = this.#parts[tile];
    if (instead === null) return parts.map((part) => part.decoded());
    const known = this.#recent?.tile === tile && this.#recent.splats.length === parts.length;
    if (!known) this.#recent = { tile, splats: parts.map((part) => part.decoded()) };
    return this.#recent!.splats.map((splats, n) => chosen(splats, parts[n].which(instead, splats)));
  }

  /** The finer tiles for which Gaussians of a tile are drawn; null among them for all of a finest one. */
  drawnOf(tile: number): (number | null)[] {
    const { children, count } = this.tiles;
    if (!children[tile].length) return this.#drawn.has(count + tile) ? [null] : [];
    return children[tile].filter((child) => this.#drawn.has(child));
  }

  look(camera: Camera | null, budget = BUDGET): boolean {
    const { packets, parents } = this.tiles,
      came = this.#came,
      there = (tile: number): boolean => came[tile] === packets[tile],
      most = (tile: number): boolean => came[tile] >= (parents[tile] < 0 ? 1 : MOST * packets[tile]);
    this.#cut = cutOf(this.tiles, there, camera, budget, most);
    const drawn = this.pieces.drawn(this.#cut),
      same = drawn.length === this.#drawn.size && drawn.every((piece) => this.#drawn.has(piece));
    if (!same) this.#drawn = new Set(drawn);
    return !same;
  }

  bytesOf(packet: Packet): number {
    return this.gaussians.bytesOf(packet);
  }

  read(packet: Packet): LevelPart {
    const part = new LevelPart(packet, this);
    this.#came[packet.block]++;
    this.#parts[packet.block].push(part);
    return part;
  }

  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string> {
    return this.gaussians.digest(blocks, pause);
  }

  copies(): Promise<Copies<LevelPart> | null> {
    return Promise.resolve(null);
  }

  elements(): Promise<null> {
    return Promise.resolve(null);
  }
}
