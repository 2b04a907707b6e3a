// Pictures of the element: made again if the view is released meanwhile, given up if its context is lost twice.

import assert from "node:assert/strict";
import { test } from "node:test";

import { pictureOf } from "../src/page/screenshot.ts";
import type { WebGLRenderer } from "../src/render/webgl_renderer.ts";

const CAMERA = { viewmat: [], focal: 1, height: 1 };

/** A stage whose first `releases` views are released during a picture; `lost` is called for each. */
function stageOf(releases: number, lost: () => void): { stage: Parameters<typeof pictureOf>[0]; fixed: unknown[] } {
  const fixed: unknown[] = [];
  const next = (): WebGLRenderer => {
    const view = {
      fixed: null,
      failed: false,
      reason: new Error("lost"),
      canvas: { toDataURL: () => "picture" },
      fix: (camera: unknown) => fixed.push(camera),
      frame: async () => undefined,
      sorted: async () => undefined,
      replacementSorted: async () => {
        if (releases-- <= 0) return;
        stage.renderer = next();
        lost();
      },
    };
    return view as unknown as WebGLRenderer;
  };
  const stage = {
    renderer: null as WebGLRenderer | null,
    withRenderer: (work: (renderer: WebGLRenderer) => void) => work(stage.renderer!),
  };
  stage.renderer = next();
  return { stage, fixed };
}

test("a picture is made although other elements take the view's context several times", async () => {
  const { stage, fixed } = stageOf(3, () => undefined);
  assert.equal(
    await pictureOf(
      stage,
      () => CAMERA,
      () => false,
      () => 0,
    ),
    "picture",
  );
  assert.deepEqual(fixed, [CAMERA, null, CAMERA, null, CAMERA, null, CAMERA, null]);
});

test("a picture is given up after the second lost context", async () => {
  for (const losses of [1, 2]) {
    let count = 5;
    const { stage } = stageOf(losses, () => count++),
      made = pictureOf(
        stage,
        () => CAMERA,
        () => false,
        () => count,
      );
    if (losses === 1) assert.equal(await made, "picture");
    else await assert.rejects(made, /lost/);
  }
});

test("a picture waits for the depth sort of its own camera", async () => {
  const { stage } = stageOf(0, () => undefined),
    pictures = ["old", "old", "old", "new", "new"];
  let drawn = 0;
  Object.assign(stage.renderer!, {
    frame: async () => void drawn++,
    canvas: { toDataURL: () => pictures[Math.min(drawn - 2, pictures.length - 1)] },
  });
  Object.defineProperty(stage.renderer!, "isSorting", { get: () => drawn < 5 });
  assert.equal(
    await pictureOf(
      stage,
      () => CAMERA,
      () => false,
      () => 0,
    ),
    "new",
  );
});
