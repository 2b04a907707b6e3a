// Previews: their pictures do not depend on the unit of length of the scene.

import assert from "node:assert/strict";
import { test } from "node:test";

import { packPreview } from "../src/render/packed_preview.ts";

/** Returns a preview of some Gaussians around a point. Lengths are in world units. */
function previewOf(middle: readonly number[], spread: number): Uint8Array {
  const count = 20,
    bytes = new Uint8Array(5 + 48 + (58 * count) / 8),
    numbers = new DataView(bytes.buffer);
  bytes.set([1, count, 10, 200, 30]);
  [...middle, spread, -1.2, -1.2, -1.2, -2.5, 1.2, 1.2, 1.2, -1].forEach((value, n) =>
    numbers.setFloat32(5 + 4 * n, value, true),
  );
  for (let n = 53; n < bytes.length; n++) bytes[n] = Math.imul(n, 0x9e3779b1) >>> 24;
  return bytes;
}

test("small and large scenes have the same previews, apart from their unit of length", () => {
  const { packed, size, background } = packPreview(previewOf([0.5, -0.25, 1], 0.75));
  assert.equal(size, 0.75);
  assert.equal(packed.count, 20);
  assert.ok(packed.centers.every((value) => Math.abs(value) < 4));
  for (const unit of [2 ** -19, 2 ** -10, 2 ** 17])
    assert.deepEqual(packPreview(previewOf([0.5 * unit, -0.25 * unit, unit], 0.75 * unit)), {
      packed,
      background,
      size: 0.75 * unit,
    });
});
