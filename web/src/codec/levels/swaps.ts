// Replacement of the drawn tiles by others, in steps that can be shown one by one.

/** A step: a tile is replaced by finer tiles below it, or the other way round. */
export interface Swap {
  readonly gone: readonly number[];
  readonly come: readonly number[];
}

/** Returns the steps from one cut of a tile tree to another, in the order of the added tiles. */
export function swapsOf(parents: Int32Array, before: ReadonlySet<number>, drawn: ReadonlySet<number>): Swap[] {
  const swaps = new Map<number, { gone: number[]; come: number[] }>();
  const swapAt = (tile: number): { gone: number[]; come: number[] } => {
    const found = swaps.get(tile) ?? { gone: [], come: [] };
    swaps.set(tile, found);
    return found;
  };
  /** Returns the coarsest tile of the other cut above a tile, or the tile itself. */
  const place = (tile: number, others: ReadonlySet<number>): number => {
    for (let above = parents[tile]; above >= 0; above = parents[above]) if (others.has(above)) return above;
    return tile;
  };
  for (const tile of [...drawn].sort((a, b) => a - b))
    if (!before.has(tile)) swapAt(place(tile, before)).come.push(tile);
  for (const tile of before) if (!drawn.has(tile)) swapAt(place(tile, drawn)).gone.push(tile);
  return [...swaps.values()];
}
