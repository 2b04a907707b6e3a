// Streams as assets of PlayCanvas.

import assert from "node:assert/strict";
import { test } from "node:test";

import type { AppBase, GSplatResource } from "playcanvas";

import { SwzParser } from "../src/integrations/playcanvas.ts";
import { Server, URL_ } from "./fake_web.ts";
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
