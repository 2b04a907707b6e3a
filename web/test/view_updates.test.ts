import assert from "node:assert/strict";
import { mock, test } from "node:test";

import type { Camera } from "../src/model/camera.ts";
import { cameraDistance, ViewUpdates } from "../src/render/view_updates.ts";

const seen = (x: number, angle = 0): Camera => {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return {
    viewmat: [
      [c, 0, -s, -c * x],
      [0, 1, 0, 0],
      [s, 0, c, -s * x],
    ],
    focal: 100,
    width: 80,
    height: 60,
    margin: 20,
  };
};

test("camera distance grows with movement and rotation, and is 1 for another picture size", () => {
  assert.equal(cameraDistance(seen(1), seen(1), 2), 0);
  assert.ok(Math.abs(cameraDistance(seen(1), seen(1.01), 2) - 0.5) < 1e-9);
  assert.ok(cameraDistance(seen(0), seen(0, 0.02), 2) < 1 && cameraDistance(seen(0), seen(0, 0.04), 2) > 1);
  assert.equal(cameraDistance(seen(0), { ...seen(0), width: 81 }, 2), 1);
});

test("one request at a time: at once for large movements, at rest for small ones", () => {
  mock.timers.enable({ apis: ["setTimeout"] });
  const asked: number[] = [],
    watch = new ViewUpdates(1, (camera) => asked.push(-camera.viewmat[0][3]));
  watch.onCamera(seen(0));
  assert.deepEqual(asked, [0]);
  watch.onCamera(seen(5));
  watch.onCamera(seen(6));
  assert.deepEqual(asked, [0], "the first answer is not there yet");
  assert.ok(!watch.settled);
  watch.onAnswer(1);
  assert.deepEqual(asked, [0, 6]);
  watch.onAnswer(2);
  assert.ok(watch.settled);
  watch.onCamera(seen(6.001));
  mock.timers.tick(100);
  watch.onCamera(seen(6.002));
  mock.timers.tick(100);
  assert.deepEqual(asked, [0, 6], "it still moves");
  mock.timers.tick(100);
  assert.deepEqual(asked, [0, 6, 6.002]);
  watch.onAnswer(3);
  watch.onCamera(seen(6.003));
  watch.onCamera(seen(6.002));
  mock.timers.tick(1000);
  assert.equal(asked.length, 3, "back where it was");
  assert.ok(watch.settled);
  mock.timers.reset();
});
