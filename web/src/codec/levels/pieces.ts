// What of a scene with levels comes and goes as one: a finest tile, or those Gaussians of a coarser one that stand for
// one of its finer tiles.

import type { Cut } from "./cut.ts";
import type { Tiles } from "./tiles.ts";

/** One of them: Gaussians of a tile, all or those that stand for a finer one. */
export interface Piece {
  readonly tile: number;
  readonly instead: number | null;
}

/** Their numbers: that of the finer tile that it stands for, or that of a finest tile behind all of those. */
export class Pieces {
  /** The coarser piece that each takes the place of, -1 for none. */
  readonly parents: Int32Array;

  constructor(readonly tiles: Tiles) {
    const { count, parents } = tiles;
    this.parents = new Int32Array(2 * count).fill(-1);
    for (let tile = 0; tile < count; tile++) {
      const above = parents[tile];
      if (above >= 0 && parents[above] >= 0) this.parents[tile] = above;
      if (above >= 0) this.parents[count + tile] = tile;
    }
  }

  of(piece: number): Piece {
    const { count, parents } = this.tiles;
    return piece < count ? { tile: parents[piece], instead: piece } : { tile: piece - count, instead: null };
  }

  /** Those that a cut draws: together they are the whole scene, as far as it is there. */
  drawn({ drawn }: Cut): number[] {
    const { count, children } = this.tiles,
      all = new Set(drawn);
    return drawn.flatMap((tile) =>
      children[tile].length ? children[tile].filter((child) => !all.has(child)) : [count + tile],
    );
  }
}
