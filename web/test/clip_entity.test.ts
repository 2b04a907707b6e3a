// Clips in PlayCanvas: the entity takes the next frame once all cameras that draw it have sorted the last one.

import assert from "node:assert/strict";
import test from "node:test";

import { type AppBase, Entity, EventHandler } from "playcanvas";

import type { Clip } from "../src/clip.ts";
import { ClipEntity } from "../src/integrations/playcanvas_clip.ts";
import type { GpuGaussians } from "../src/render/gpu_gaussians.ts";
import { pack } from "../src/render/packed.ts";
import { deviceOf } from "./null_device.ts";

/** Layer of the entity, and another one. */
const WORLD = { id: 0 },
  OTHER = { id: 7 };

/** Reports of a camera that draws a layer: the layer, and whether it has sorted the newest frame. */
type Report = readonly [{ readonly id: number }, boolean];

/** An application with a clip whose frames are always there. The test imitates its cameras. */
class FakeApp extends EventHandler {
  renderNextFrame = false;
  readonly graphicsDevice = deviceOf();
  readonly scene = { gsplat: { antiAlias: false } };
  readonly gsplat = Object.assign(new EventHandler(), {
    addComponent: (entity: Entity, { resource }: { resource: GpuGaussians }) =>
      Object.assign(entity, { gsplat: { resource, layers: [WORLD.id] } }),
  });
  readonly systems = { gsplat: this.gsplat };
  taken = 0;
  degree = 0;
  readonly clip = {
    size: 2,
    antialiased: false,
    update: () => ({ number: this.taken++, packed: pack([], this.degree, 1) }),
  };
  readonly entity = new ClipEntity(this as unknown as AppBase, this.clip as unknown as Clip);

  constructor() {
    super();
    const root = new Entity("root", this as unknown as AppBase);
    (root as unknown as { _enabledInHierarchy: boolean })._enabledInHierarchy = true;
    root.addChild(this.entity);
  }

  /** Draws a picture. Returns the number of frames that the entity has taken so far. */
  picture(...reports: readonly Report[]): number {
    this.fire("update");
    for (const [layer, isReady] of reports) this.gsplat.fire("frame:ready", null, layer, isReady, 0);
    this.fire("postrender");
    return this.taken;
  }

  get drawn(): GpuGaussians {
    return (this.entity.children[0] as Entity).gsplat!.resource as GpuGaussians;
  }
}

test("the next frame is taken once all cameras that draw the entity have sorted the last one", () => {
  const app = new FakeApp();
  assert.equal(app.picture([WORLD, false]), 1);
  assert.equal(app.picture(), 1);
  assert.equal(app.picture([OTHER, true]), 1);
  assert.equal(app.picture([WORLD, true], [WORLD, false]), 1);
  assert.equal(app.picture([WORLD, false], [WORLD, true]), 1);
  assert.equal(app.picture([WORLD, true], [OTHER, false], [WORLD, true]), 1);
  assert.equal(app.picture([WORLD, true]), 2, "sorted before");
  assert.equal(app.picture([WORLD, true]), 3);
});

test("a disabled entity takes no frames, and goes on once it is enabled", () => {
  const app = new FakeApp();
  app.picture([WORLD, true]);
  app.entity.enabled = false;
  for (let n = 0; n < 3; n++) assert.equal(app.picture([WORLD, true]), 1);
  app.entity.enabled = true;
  assert.equal(app.picture([WORLD, true]), 2);
});

test("pictures are requested until the frame is on the screen", () => {
  const app = new FakeApp();
  for (const isReady of [false, false, true]) {
    app.renderNextFrame = false;
    app.picture([WORLD, isReady]);
    assert.equal(app.renderNextFrame, true);
  }
});

test("frames of a live clip may have another degree, and may become antialiased", () => {
  const app = new FakeApp();
  for (const degree of [0, 0, 3, 3, 1]) {
    app.degree = degree;
    app.picture([WORLD, true]);
    assert.equal(app.drawn.degree, degree);
    assert.equal(app.scene.gsplat.antiAlias, false);
  }
  app.clip.antialiased = true;
  app.picture([WORLD, true]);
  assert.equal(app.scene.gsplat.antiAlias, true);
});

test("a removed entity takes no frames", () => {
  const app = new FakeApp();
  app.picture([WORLD, true]);
  app.entity.destroy();
  assert.equal(app.picture([WORLD, true]), 1);
});
