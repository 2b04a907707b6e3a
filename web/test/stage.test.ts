// Framing of clips: an empty frame, sent as an invisible Gaussian at 0, takes no part.

import assert from "node:assert/strict";
import { test } from "node:test";

import { emptySplats } from "../src/codec/splats.ts";
import { Stage } from "../src/page/stage.ts";
import { type Packed, pack } from "../src/render/packed.ts";

const EMPTY = pack([emptySplats(1, 0)], 0, 1);

/** Returns visible Gaussians on a line of 2 units from -1, 0, 0 to 1, 0, 0, moved along z. */
function line(z: number): Packed {
  const splats = emptySplats(21, 0);
  for (let n = 0; n < splats.count; n++) splats.means.set([n / 10 - 1, 0, z], 3 * n);
  splats.opacities.fill(0.9);
  splats.scales.fill(0.01);
  return pack([splats], 0, 1);
}

/** Returns an invisible stage of 800 x 600 pixels, without a document. */
function stageOf(): Stage {
  const nothing = (): void => undefined,
    classList = { add: nothing, remove: nothing, toggle: nothing };
  const createElement = (): object => ({
    setAttribute: nothing,
    append: nothing,
    addEventListener: nothing,
    classList,
    clientWidth: 800,
    clientHeight: 600,
  });
  Object.assign(globalThis, { document: { createElement }, cancelAnimationFrame: nothing });
  const stage = new Stage(nothing, assert.fail, "a clip");
  stage.isVisible = false;
  stage.begin(1);
  return stage;
}

test("a camera is framed by the first frame that is not empty", () => {
  const stage = stageOf(),
    plain = stageOf();
  stage.add(EMPTY, true);
  assert.equal(stage.count, 0);
  stage.resize();
  assert.equal(stage.orbit.space(), null); // nothing limits the camera
  stage.add(line(0), true);
  plain.add(line(0), true);
  assert.equal(stage.count, 21);
  assert.ok(stage.orbit.distance > 1);
  assert.deepEqual(stage.viewpoint, plain.viewpoint);
});

test("a viewpoint far from 0 is kept if the first frame is empty", () => {
  const stage = stageOf(),
    viewpoint = { eye: [0, 0, 5003], target: [0, 0, 5000], up: [0, 1, 0] } as const;
  stage.add(EMPTY, true);
  stage.setViewpoint({ ...viewpoint, eye: [...viewpoint.eye], target: [...viewpoint.target], up: [...viewpoint.up] });
  stage.add(line(5000), true);
  assert.equal(stage.orbit.placed, true);
  const { eye } = stage.viewpoint;
  assert.ok(Math.hypot(eye[0], eye[1], eye[2] - 5003) < 1e-3, String(eye));
});
