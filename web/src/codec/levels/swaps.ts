// Replacement of the drawn tiles by others, in steps that can be shown one by one.

/** A step: a tile is replaced by finer tiles below it, or the other way round. */
export interface Swap {
  readonly removed: readonly number[];
  readonly added: readonly number[];
}

/** Returns the steps from one cut of a tile tree to another, in the order of the added tiles. */
export function swapsOf(parents: Int32Array, before: ReadonlySet<number>, drawn: ReadonlySet<number>): Swap[] {
  const swaps = new Map<number, { removed: number[]; added: number[] }>();
  const swapAt = (tile: number): { removed: number[]; added: number[] } => {
    const swap = swaps.get(tile) ?? { removed: [], added: [] };
    swaps.set(tile, swap);
    return swap;
  };
  /** Returns the coarsest tile of the other cut above a tile, or the tile itself. */
  const ancestorIn = (tile: number, others: ReadonlySet<number>): number => {
    for (let above = parents[tile]; above >= 0; above = parents[above]) if (others.has(above)) return above;
    return tile;
  };
  for (const tile of [...drawn].sort((a, b) => a - b))
    if (!before.has(tile)) swapAt(ancestorIn(tile, before)).added.push(tile);
  for (const tile of before) if (!drawn.has(tile)) swapAt(ancestorIn(tile, drawn)).removed.push(tile);
  return [...swaps.values()];
}
