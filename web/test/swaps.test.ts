// Replacement of drawn tiles step by step; every step shows the whole scene once.

import assert from "node:assert/strict";
import test from "node:test";

import { swapsOf } from "../src/codec/levels/swaps.ts";

let state = 1;
const random = (): number => (state = (state * 48271) % 2147483647) / 2147483647;

const childrenOf = (tile: number, parents: Int32Array): number[] =>
  [...parents.keys()].filter((child) => parents[child] === tile);

/** Returns a random cut: tiles that cover every finest tile exactly once. */
function cut(parents: Int32Array): Set<number> {
  const shown = new Set([...parents.keys()].filter((tile) => parents[tile] < 0));
  for (const tile of parents.keys()) {
    const children = childrenOf(tile, parents);
    if (!shown.has(tile) || !children.length || random() < 0.4) continue;
    shown.delete(tile);
    for (const child of children) shown.add(child);
  }
  return shown;
}

/** Returns the finest tiles below the given ones, ascending. */
function finest(tiles: Iterable<number>, parents: Int32Array): number[] {
  const below = (tile: number): number[] => {
    const children = childrenOf(tile, parents);
    return children.length ? children.flatMap(below) : [tile];
  };
  return [...tiles].flatMap(below).sort((a, b) => a - b);
}

test("each swap leaves a complete scene", () => {
  for (let round = 0; round < 300; round++) {
    const count = 1 + Math.floor(30 * random()),
      parents = Int32Array.from({ length: count }, (_, n) => Math.floor((n + 1) * random()) - 1),
      held = round % 10 ? cut(parents) : new Set<number>(),
      drawn = cut(parents),
      shown = new Set(held);
    for (const { removed, added } of swapsOf(parents, held, drawn)) {
      for (const tile of removed) assert.ok(shown.delete(tile));
      for (const tile of added) assert.ok(!shown.has(tile) && shown.add(tile));
      const leaves = finest(shown, parents);
      assert.equal(new Set(leaves).size, leaves.length);
      if (held.size) assert.deepEqual(leaves, finest(held, parents));
    }
    assert.deepEqual([...shown].sort(), [...drawn].sort());
  }
});
