import assert from "node:assert/strict";
import { test } from "node:test";

import { CONCEALERS } from "../src/conceal/conceal.ts";
import { grow } from "../src/conceal/grow.ts";
import { KdTree } from "../src/conceal/kd_tree.ts";
import { random } from "./vectors.ts";

const next = random(3), points = Float32Array.from({ length: 3 * 400 }, () => Math.round(next() * 60));
const always = (): Promise<boolean> => Promise.resolve(true);

test("nearest others are those of a search through all", () => {
  const tree = new KdTree(points, 9);
  for (let i = 0; i < 400; i += 7) {
    const far = (j: number): number => [0, 1, 2].reduce((sum, a) => sum + (points[3 * i + a] - points[3 * j + a]) ** 2, 0);
    const all = Array.from({ length: 400 }, (_, j) => j).filter((j) => j !== i).map(far).sort((a, b) => a - b).slice(0, 9);
    assert.deepEqual([...tree.nearestOthers(i)].map(far).sort((a, b) => a - b), all);
  }
});

test("nothing grows where nothing is lost, and gains follow the share that is left", async () => {
  const sizes = new Float32Array(400).fill(2), known = new Uint8Array(400).fill(1);
  assert.ok((await grow({ positions: points, sizes, known }, always))!.every((gain) => gain === 1));
  for (let i = 0; i < 400; i += 2) known[i] = 0;
  const gains = (await grow({ positions: points, sizes, known }, always))!, most = 1.08 * Math.SQRT2;
  assert.ok(gains.every((gain, i) => (known[i] ? gain >= 1 && gain <= most + 1e-6 : gain === 1)));
  assert.ok(gains.some((gain) => gain > 1.3));
});

test("what nobody waits for any more stops", async () => {
  const known = Uint8Array.from({ length: 400 }, (_, i) => i % 2);
  assert.equal(await grow({ positions: points, sizes: new Float32Array(400).fill(1), known }, () => Promise.resolve(false)), null);
  assert.deepEqual(Object.keys(CONCEALERS), ["drop", "grow"]);
});
