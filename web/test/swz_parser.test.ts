// Streams as assets of PlayCanvas.

import assert from "node:assert/strict";
import { test } from "node:test";

import type { AppBase, GSplatResource } from "playcanvas";

import { SwzParser } from "../src/integrations/playcanvas.ts";
import { loadSplats } from "../src/integrations/three.ts";
import { Server, URL_, whole } from "./fake_web.ts";
import { deviceOf } from "./null_device.ts";
import { fileOf } from "./vectors.ts";

const camera = {
  viewmat: [
    [1, 0, 0, 0],
    [0, 1, 0, 0.1],
    [0, 0, 1, 2],
    [0, 0, 0, 1],
  ],
  focal: 200,
  width: 160,
  height: 120,
  margin: 0,
};

/** Returns an answer whose last kilobyte, several packets, arrives later. */
function delayed(file: Uint8Array): Response {
  const parts = [file.slice(0, -1000), file.slice(-1000)],
    pull = async (controller: ReadableStreamDefaultController): Promise<void> => {
      await new Promise((resolve) => setTimeout(resolve, 50));
      const next = parts.shift();
      if (next) controller.enqueue(next);
      else controller.close();
    };
  return new Response(new ReadableStream({ pull }), { headers: { "Content-Length": String(file.length) } });
}

test("the whole scene is loaded, also if the application leaves the concealer undefined", async () => {
  const file = fileOf("../tests/golden/tiny_causal.swz"),
    app = { graphicsDevice: deviceOf(), scene: { gsplat: {} } } as unknown as AppBase,
    counts: number[] = [];
  for (const options of [{ camera }, { camera, concealer: undefined }] as object[]) {
    new Server(() => delayed(file));
    const resource = await new Promise<GSplatResource>((resolve, reject) =>
      new SwzParser(app, options).load(URL_, (error, found) => (found ? resolve(found) : reject(new Error(error!)))),
    );
    counts.push(resource.gsplatData.numSplats);
  }
  assert.ok(counts[0] > 0);
  assert.equal(counts[1], counts[0]);
});

test("missing packets of an asset, or of a stream for Spark, are reported on the console", async (context) => {
  const file = fileOf("../tests/golden/tiny_levels.swz"),
    app = { graphicsDevice: deviceOf(), scene: { gsplat: {} } } as unknown as AppBase,
    said: string[] = [];
  context.mock.method(console, "warn", (text: string) => said.push(text));
  for (const cut of [0, 600]) {
    new Server(() => whole(file.slice(0, file.length - cut)));
    await new Promise<void>((resolve, reject) =>
      new SwzParser(app).load(`${URL_}?token=1`, (error) => (error ? reject(new Error(error)) : resolve())),
    );
    await loadSplats(`${URL_}?token=1`);
    assert.equal(said.length, cut ? 2 : 0, said.join());
    for (const text of said) assert.match(text, /^https:\S+\/a\.swz: \d+ of \d+ packets received/);
  }
});
