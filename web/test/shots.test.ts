// Shots of a clip: the shot of each block of keyframe Gaussians.

import assert from "node:assert/strict";
import { test } from "node:test";

import { type SequenceInfo, shotOf } from "../src/codec/tracks/side_info.ts";

test("the shot of a block is found without a search through all shots, also if some shots have no blocks", () => {
  let reads = 0;
  const shots = Array.from({ length: 4000 }, (_, n) => ({
    number: n,
    get firstBlock(): number {
      reads++;
      return 3 * (n - (n % 2)); // every other shot has none
    },
  }));
  const info = { shots } as unknown as SequenceInfo;
  for (let block = 0; block < 12_000; block++) {
    reads = 0;
    assert.equal(shotOf(info, block), shots[2 * Math.floor(block / 6) + 1]);
    assert.ok(reads <= 13, `${reads} shots`);
  }
});
