// Drawing units of scenes with levels: a finest tile, or the Gaussians of a coarser tile that represent one of its
// children.

import type { Cut } from "./cut.ts";
import type { Tiles } from "./tiles.ts";

/** A drawing unit: all Gaussians of `tile` if `child` is null, otherwise those that represent that child. */
export interface DrawUnit {
  readonly tile: number;
  readonly child: number | null;
}

/**
 * Numbering of the drawing units. Unit n below the number of tiles represents tile n; unit count + n is the finest tile
 * n.
 */
export class DrawUnits {
  /** The coarser unit that each unit replaces; -1 if there is none. */
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

  of(unit: number): DrawUnit {
    const { count, parents } = this.tiles;
    return unit < count ? { tile: parents[unit], child: unit } : { tile: unit - count, child: null };
  }

  /** Returns the units that a cut draws. Their union is the received scene, without overlap. */
  drawn({ drawn }: Cut): number[] {
    const { count, children } = this.tiles,
      all = new Set(drawn);
    return drawn.flatMap((tile) =>
      children[tile].length ? children[tile].filter((child) => !all.has(child)) : [count + tile],
    );
  }
}
