// Framing of clips: an empty frame, sent as an invisible Gaussian at 0, takes no part.

import assert from "node:assert/strict";
import { type TestContext, test } from "node:test";

import type { Viewpoint } from "../src/codec/decoder.ts";
import { emptySplats } from "../src/codec/splats.ts";
import { Stage } from "../src/page/stage.ts";
import { RENDERER } from "../src/render/load.ts";
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

/** Sets globals until the end of a test. */
function setGlobals(context: TestContext, globals: object): void {
  for (const [name, value] of Object.entries(globals)) {
    const before = Object.getOwnPropertyDescriptor(globalThis, name);
    Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
    context.after(() => {
      if (before) Object.defineProperty(globalThis, name, before);
      else Reflect.deleteProperty(globalThis, name);
    });
  }
}

/** Returns an invisible stage of 800 x 600 pixels, without a document. */
function stageOf(context: TestContext, failed: (error: Error) => void = assert.fail): Stage {
  const nothing = (): void => undefined,
    classList = { add: nothing, remove: nothing, toggle: nothing };
  const createElement = (): object => ({
    setAttribute: nothing,
    append: nothing,
    prepend: nothing,
    remove: nothing,
    addEventListener: nothing,
    classList,
    clientWidth: 800,
    clientHeight: 600,
  });
  setGlobals(context, { document: { createElement }, cancelAnimationFrame: nothing });
  const stage = new Stage(nothing, failed, "a clip");
  stage.isVisible = false;
  stage.begin(1);
  return stage;
}

test("a camera is framed by the first frame that is not empty", (context) => {
  const stage = stageOf(context),
    plain = stageOf(context);
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

test("a viewpoint far from 0 is kept if the first frame is empty", (context) => {
  const stage = stageOf(context),
    viewpoint = { eye: [0, 0, 5003], target: [0, 0, 5000], up: [0, 1, 0] } as const;
  stage.add(EMPTY, true);
  stage.setViewpoint({ ...viewpoint, eye: [...viewpoint.eye], target: [...viewpoint.target], up: [...viewpoint.up] });
  stage.add(line(5000), true);
  assert.equal(stage.orbit.placed, true);
  const { eye } = stage.viewpoint;
  assert.ok(Math.hypot(eye[0], eye[1], eye[2] - 5003) < 1e-3, String(eye));
});

test("the framing Gaussians determine the viewpoint instead of the drawn ones, unless the visitor moved", (context) => {
  const [expected, before, after, moved] = Array.from({ length: 4 }, () => stageOf(context));
  expected.add(line(7));
  before.framingGaussians = line(7);
  before.add(line(0));
  after.add(line(0));
  assert.notDeepEqual(after.viewpoint, expected.viewpoint);
  after.framingGaussians = line(7);
  after.resize();
  for (const stage of [before, after]) {
    assert.deepEqual(stage.viewpoint, expected.viewpoint);
    for (const z of [1, 2, 3]) stage.add(line(z));
    stage.end();
    assert.deepEqual(stage.viewpoint, expected.viewpoint);
  }
  moved.add(line(0));
  moved.orbit.rotate(0.5, 0);
  const { viewpoint } = moved;
  moved.framingGaussians = line(7);
  moved.resize();
  moved.end();
  assert.deepEqual(moved.viewpoint, viewpoint);
});

test("a preview is framed by its own Gaussians, although those of the scene are known", (context) => {
  const stage = stageOf(context),
    plain = stageOf(context),
    preview = { packed: line(0), background: [0, 0, 0], size: 1 } as const;
  stage.framingGaussians = line(7);
  for (const each of [stage, plain]) void each.preview(preview);
  assert.deepEqual(stage.viewpoint, plain.viewpoint);
});

test("the automatic rotation continues when the scene is framed again", (context) => {
  const stage = stageOf(context),
    { orbit } = stage;
  stage.add(line(0), true);
  const { yaw } = orbit;
  for (let n = 0; n < 5; n++) orbit.drift(0.2);
  assert.ok(Math.abs(orbit.yaw - yaw - 1) < 1e-6);
  const framed = orbit.state;
  stage.resize();
  assert.ok(Math.abs(orbit.yaw - framed.yaw) < 1e-6);
  stage.pointCameraAt([0, 0, 0], 1);
  stage.add(line(0));
  stage.setLimits(null);
  assert.ok(Math.abs(orbit.yaw - framed.yaw) < 1e-6);
  orbit.reset();
  assert.equal(orbit.yaw, yaw);
  const viewpoint: Viewpoint = { eye: [0, 0, 3], target: [0, 0, 0], up: [0, 1, 0] };
  Object.assign(orbit, { touched: false });
  stage.setViewpoint(viewpoint);
  assert.ok(Math.abs(stage.viewpoint.eye[2] - 3) < 1e-6);
  stage.resize();
  assert.ok(Math.abs(stage.viewpoint.eye[2] - 3) < 1e-6);
});

test("a renderer that could not be loaded is requested again after a minute", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const errors: string[] = [],
    stage = stageOf(context, ({ message }) => errors.push(message));
  stage.startWebGL();
  let isOpening = true;
  void stage.open().then(() => (isOpening = false));
  while (isOpening) {
    await new Promise((resolve) => setImmediate(resolve));
    context.mock.timers.tick(1000);
  }
  assert.deepEqual(errors, ["The renderer is missing; reload the page."]);
  let started = 0;
  class Opened {
    constructor() {
      started++;
      throw new Error("no WebGL");
    }
  }
  setGlobals(context, { [RENDERER]: Opened });
  stage.isVisible = true;
  for (let seconds = 0; seconds < 61; seconds++) {
    await new Promise((resolve) => setImmediate(resolve));
    context.mock.timers.tick(1000);
  }
  assert.equal(started, 1);
  stage.destroy();
});

test("a context that is lost repeatedly is requested with growing pauses, then given up", async (context) => {
  const { timers } = context.mock;
  timers.enable({ apis: ["setTimeout"] });
  const errors: Error[] = [],
    lost: (() => void)[] = [],
    nothing = (): void => undefined;
  const surface = { append: nothing, prepend: nothing, setAttribute: nothing, addEventListener: nothing },
    classList = { add: nothing, remove: nothing, toggle: nothing };
  const createElement = (): object => ({
    ...surface,
    classList,
    addEventListener: (kind: string, lose: () => void) => kind === "webglcontextlost" && lost.push(lose),
  });
  const methods = "background antialias begin end add destroy touch".split(" ").map((name) => [name, nothing]);
  class FakeView {
    failed = false;
    fixed: object | null = null;
    readonly reason = new Error("no memory");
    readonly sorted = async (): Promise<void> => undefined;
    readonly failuresAfter = (failures: number): number => failures + 1;
    constructor() {
      Object.assign(this, Object.fromEntries(methods));
    }
  }
  setGlobals(context, {
    window: globalThis,
    document: { createElement },
    cancelAnimationFrame: nothing,
    [RENDERER]: FakeView,
  });
  const stage = new Stage(nothing, (error) => errors.push(error), "a scene");
  const settle = async (): Promise<void> => {
    for (let n = 0; n < 20; n++) await null;
  };
  let numLosses = 0;
  stage.onContextLost = () => numLosses++;
  stage.startWebGL();
  void stage.open();
  for (let pictures = 1; pictures <= 10; pictures++) {
    await settle();
    Object.assign(stage.renderer!, { failed: true, fixed: {} }); // a picture of its own size that needs too much memory
    lost.at(-1)!();
    timers.tick(1000);
    lost.length = 0;
  }
  assert.deepEqual([numLosses, errors.length], [0, 0]);
  await settle();
  lost.unshift(nothing); // the last one counts as the first failure of the context
  for (let failures = 2; failures <= 9; failures++) {
    await settle();
    assert.equal(lost.length, failures);
    assert.equal(errors.length, 0);
    lost.at(-1)!();
    timers.tick(1000 * 2 ** (failures - 1) - 1);
    await settle();
    assert.equal(lost.length, failures);
    timers.tick(1);
  }
  await settle();
  assert.deepEqual(
    errors.map(({ message }) => message),
    ["no memory"],
  );
  void stage.open();
  stage.setVisible(false);
  stage.setVisible(true);
  await settle();
  assert.equal(lost.length, 9);
  const now = performance.now() + 61_000;
  context.mock.method(performance, "now", () => now);
  stage.setVisible(false);
  stage.setVisible(true);
  await settle();
  assert.equal(lost.length, 10);
  lost.at(-1)!();
  await settle();
  assert.equal(errors.length, 2);
});
