import assert from "node:assert/strict";
import { test } from "node:test";

import type { Camera } from "../src/model/camera.ts";
import { gaussianBudget } from "../src/page/gaussian_budget.ts";
import { limitsOf } from "../src/page/links.ts";
import { ViewUpdates } from "../src/render/view_updates.ts";

test("the budget is that of the attribute or of the device, and halves with each lost context", () => {
  for (const nothing of [null, "", "0", "-3", "many"]) assert.equal(gaussianBudget(nothing, 0), 1_000_000);
  assert.equal(gaussianBudget("200000", 0), 200_000);
  assert.equal(gaussianBudget("200000", 1), 100_000);
  assert.equal(gaussianBudget(null, 2), 250_000);
  assert.equal(gaussianBudget(null, 20), 50_000);
  assert.equal(gaussianBudget("700", 3), 700, "losses never raise it");
  Object.defineProperty(globalThis, "navigator", { value: { deviceMemory: 4 }, configurable: true });
  assert.equal(gaussianBudget(null, 0), 500_000);
  assert.equal(gaussianBudget("800000", 0), 800_000);
});

test("limits are four ordered numbers", () => {
  assert.deepEqual(limitsOf("1 5.5 20 90"), [1, 5.5, 20, 90]);
  for (const wrong of [null, "", "1 2 3", "2 1 0 90", "-1 2 0 90", "1 2 90 20", "1 2 a 90"])
    assert.equal(limitsOf(wrong), null);
});

test("a view is requested again for the same camera", () => {
  const camera: Camera = { viewmat: [[1], [0], [0]], focal: 1, width: 1, height: 1, margin: 0 };
  let requests = 0;
  const updates = new ViewUpdates(1, () => requests++);
  updates.repeat();
  assert.equal(requests, 0, "no camera is known");
  updates.onCamera(camera);
  updates.onAnswer(1);
  updates.repeat();
  assert.equal(requests, 2);
});
