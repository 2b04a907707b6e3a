import assert from "node:assert/strict";
import { test } from "node:test";

import { texelRectangles } from "../src/render/gpu_limits.ts";

test("rectangles cover each texel once, in order, with at most three rectangles", () => {
  for (const across of [1, 4, 7]) {
    for (let first = 0; first < 20; first++) {
      for (let end = first; end < 40; end++) {
        const found = texelRectangles(first, end, across),
          texels = found.flatMap(({ x, y, width, height }) => {
            assert.ok(x + width <= across);
            return Array.from({ length: width * height }, (_, n) => {
              return (y + Math.floor(n / width)) * across + x + (n % width);
            });
          });
        assert.deepEqual(
          texels,
          Array.from({ length: end - first }, (_, n) => first + n),
        );
        assert.ok(found.length <= 3);
      }
    }
  }
});
