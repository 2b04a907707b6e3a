// Gaussians in levels: what is drawn depends on where somebody looks from, and on what is there.

import { CONCEALERS, type Pause } from "../../conceal/conceal.ts";
import type { Camera } from "../../model/camera.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import { GaussianSchema } from "../gaussians/schema.ts";
import type { Copies, Part, Schema, Seen } from "../schema.ts";
import { emptySplats, type Splats } from "../splats.ts";
import { type Cut, cutOf } from "./cut.ts";
import { readTiles, type Tiles } from "./tiles.ts";

/** Which tiles are drawn, and which are to be fetched. */
export interface Tiling {
  readonly tiles: Tiles;
  readonly wanted: readonly number[];
  /** Gaussians that are enough to look around. */
  readonly enough: number;
  /** Tiles that are drawn, ascending. */
  readonly drawn: readonly number[];
  /** Looks again; whether other tiles are drawn than before. */
  look(camera: Camera | null): boolean;
  /** Packets of a tile that came. */
  partsOf(tile: number): readonly Part[];
  /** Their Gaussians, decoded anew. */
  splatsOf(tile: number): Splats[];
}

/** A packet; decoded when it is drawn, and forgotten when it is not any more. */
class LevelPart implements Part {
  #splats: Splats | null = null;

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

  seen(): Seen {
    if (!this.schema.draws(this.packet.block)) {
      this.#splats = null;
      return { splats: this.schema.none, owners: new Int32Array() };
    }
    this.#splats ??= this.schema.gaussians.read(this.packet).splats;
    return { splats: this.#splats, owners: Int32Array.from({ length: this.count }, (_, n) => n) };
  }
}

export class LevelSchema implements Schema<LevelPart>, Tiling {
  readonly tiling = this;
  readonly viewDependent = true;
  readonly moving = null;
  /** Losses are hidden by coarser tiles: a finer one is drawn when all of it is there. */
  readonly concealers = { drop: CONCEALERS.drop };
  readonly gaussians: GaussianSchema;
  readonly tiles: Tiles;
  readonly none: Splats;
  readonly #came: Int32Array;
  readonly #parts: LevelPart[][];
  #cut: Cut = { drawn: [], wanted: [] };
  #drawn = new Set<number>();

  constructor(sideInfo: Uint8Array, plan: Plan) {
    this.gaussians = new GaussianSchema(sideInfo, plan);
    this.tiles = readTiles(this.gaussians.info, plan);
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
    return this.#cut.drawn;
  }

  partsOf(tile: number): readonly LevelPart[] {
    return this.#parts[tile];
  }

  splatsOf(tile: number): Splats[] {
    return this.#parts[tile].map(({ packet }) => this.gaussians.read(packet).splats);
  }

  draws(tile: number): boolean {
    return this.#drawn.has(tile);
  }

  look(camera: Camera | null): boolean {
    this.#cut = cutOf(this.tiles, (tile) => this.#came[tile] === this.tiles.packets[tile], camera);
    const { drawn } = this.#cut,
      same = drawn.length === this.#drawn.size && drawn.every((tile) => this.#drawn.has(tile));
    if (!same) this.#drawn = new Set(drawn);
    return !same;
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
