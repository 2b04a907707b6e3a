// From what is on the screen to what ought to be, in steps that can be shown one by one.

/** Tiles that others take the place of: a tile and the finer ones below it, one way or the other. */
export interface Swap {
  readonly gone: readonly number[];
  readonly come: readonly number[];
}

/** The swaps between two cuts of a tree, each of which stands for a scene; in the order of what they bring. */
export function swapsOf(parents: Int32Array, held: ReadonlySet<number>, drawn: ReadonlySet<number>): Swap[] {
  const swaps = new Map<number, { gone: number[]; come: number[] }>();
  const swapAt = (tile: number): { gone: number[]; come: number[] } => {
    const found = swaps.get(tile) ?? { gone: [], come: [] };
    swaps.set(tile, found);
    return found;
  };
  /** The coarsest tile of the other cut that a tile lies below; itself where there is none. */
  const place = (tile: number, others: ReadonlySet<number>): number => {
    for (let above = parents[tile]; above >= 0; above = parents[above]) if (others.has(above)) return above;
    return tile;
  };
  for (const tile of [...drawn].sort((a, b) => a - b)) if (!held.has(tile)) swapAt(place(tile, held)).come.push(tile);
  for (const tile of held) if (!drawn.has(tile)) swapAt(place(tile, drawn)).gone.push(tile);
  return [...swaps.values()];
}
