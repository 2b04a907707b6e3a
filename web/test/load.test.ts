// Loading of the renderer's bundle: a failed request, and a bundle of another version from a cache, are tried again.

import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { type TestContext, test } from "node:test";
import { fileURLToPath } from "node:url";

import { loadRenderer, RENDERER } from "../src/render/load.ts";

const fileAt = (name: string): string => fileURLToPath(new URL(name, import.meta.url)),
  BUNDLE = fileAt("splatwire-view.js"),
  world = globalThis as Record<string, unknown>;

/** Lets time pass until a promise settles. */
async function settled<T>(context: TestContext, work: Promise<T>): Promise<T> {
  let isPending = true;
  const done = work.finally(() => (isPending = false));
  done.catch(() => undefined);
  while (isPending) {
    await new Promise((resolve) => setImmediate(resolve));
    context.mock.timers.tick(500);
  }
  return done;
}

test("a renderer that was missing, or of another version, is loaded once its server has it", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  writeFileSync(fileAt("package.json"), '{"type": "module"}');
  await assert.rejects(settled(context, loadRenderer()), /splatwire-view/);
  writeFileSync(BUNDLE, "globalThis.requests = (globalThis.requests ?? 0) + 1; globalThis.splatwireViewOther = {};");
  await assert.rejects(settled(context, loadRenderer()), /another version/);
  assert.equal(world["requests"], 6);
  const found = loadRenderer();
  writeFileSync(BUNDLE, `globalThis.${RENDERER} = "the renderer"`);
  assert.equal(await settled(context, found), "the renderer");
  delete world[RENDERER];
});
