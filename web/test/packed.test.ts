import assert from "node:assert/strict";
import { test } from "node:test";

import { FloatPacking } from "playcanvas";

import { emptySplats } from "../src/codec/splats.ts";
import { HALF_FLOAT_VALUES, keepPacked, pack, toHalfFloat } from "../src/render/packed.ts";
import { random } from "./vectors.ts";

const next = random(7);

test("floats are rounded to the nearest half float, at least as well as by PlayCanvas", () => {
  for (let bits = 0; bits < 65536; bits++)
    if (!Number.isNaN(HALF_FLOAT_VALUES[bits])) assert.equal(toHalfFloat(HALF_FLOAT_VALUES[bits]), bits);
  for (let n = 0; n < 20000; n++) {
    const value = Math.fround((next() - 0.5) * 2 ** (40 * next() - 28)),
      found = HALF_FLOAT_VALUES[toHalfFloat(value)],
      theirs = HALF_FLOAT_VALUES[FloatPacking.float2Half(value)];
    assert.ok(
      Math.abs(found - value) <= Math.abs(theirs - value) || !Number.isFinite(theirs),
      `${value}: ${found}, ${theirs}`,
    );
  }
});

test("parts are packed one after another in units of the scene's size", () => {
  const parts = [3, 0, 2].map((count) => {
    const splats = emptySplats(count, 1);
    for (const array of [splats.means, splats.quats, splats.scales, splats.opacities, splats.colours, splats.harmonics])
      array.forEach((_, n) => (array[n] = Math.fround(next() - 0.4)));
    return splats;
  });
  const packed = pack(parts, 1, 4),
    last = parts[2];
  assert.equal(packed.count, 5);
  assert.deepEqual(
    [...packed.centers.subarray(16, 20)],
    [...last.means.subarray(3, 6)].map((value) => value / 4).concat(1),
  );
  const sign = last.quats[4] < 0 ? -1 : 1;
  assert.deepEqual(
    [...packed.rotations.subarray(16, 20)],
    [...last.quats.subarray(4, 8)].map((value) => toHalfFloat(sign * value)),
  );
  assert.equal(packed.opacities[4], last.opacities[1]);
  const halvesOf = (t: number): Uint16Array => {
    const { buffer, byteOffset, length } = packed.harmonics[t];
    return new Uint16Array(buffer, byteOffset, 2 * length);
  };
  const harmonics = halvesOf(0).subarray(32, 40),
    more = halvesOf(1).subarray(32, 33);
  assert.deepEqual([...harmonics, ...more], [...last.harmonics.subarray(9, 18)].map(toHalfFloat));
});

test("Gaussians that were packed elsewhere are packed together with others", () => {
  const parts = [3, 1, 2].map((count) => {
    const splats = emptySplats(count, 3);
    for (const array of [splats.means, splats.quats, splats.scales, splats.opacities, splats.colours, splats.harmonics])
      array.forEach((_, n) => (array[n] = Math.fround(next() - 0.4)));
    return splats;
  });
  const expected = pack(parts, 3, 4);
  keepPacked(parts[1], pack([parts[1]], 3, 4));
  keepPacked(parts[2], pack([parts[2]], 3, 4));
  assert.deepEqual(pack(parts, 3, 4), expected);
  parts[1].means.fill(1); // what was kept is for one call
  assert.notDeepEqual(pack(parts, 3, 4), expected);
});
