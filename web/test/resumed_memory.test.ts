// Memory of a scene that is restored from the browser's cache, until its file is revalidated.

import assert from "node:assert/strict";
import { test } from "node:test";
import { setFlagsFromString } from "node:v8";
import { runInNewContext } from "node:vm";

import { type FromHelper, PacketHelper, type ToHelper } from "../src/packet_helper.ts";
import type { HelperThread } from "../src/packet_pool.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { WorkerReceiver } from "../src/worker_receiver.ts";
import { Caches, part, Server, URL_, visit } from "./fake_web.ts";
import { fileOf } from "./vectors.ts";

/** A scene that is large enough for helpers. */
const SCENE = fileOf("../src/splatwire/assets/snowmiku_gaussians.swz");

setFlagsFromString("--expose-gc");
const collectGarbage = runInNewContext("gc") as () => void;

/** Helper of the test, which answers in later tasks. */
class Helper implements HelperThread {
  static started = 0;
  onmessage: HelperThread["onmessage"] = null;
  onerror: HelperThread["onerror"] = null;
  readonly #helper = new PacketHelper((data) => this.onmessage?.({ data } as MessageEvent<FromHelper>));

  constructor() {
    Helper.started++;
  }

  postMessage(message: ToHelper): void {
    setImmediate(() => this.#helper.receive(message));
  }

  terminate(): void {
    this.onmessage = null;
  }
}

/** Bytes of all arrays in use: the least after several collections, because memory is also freed in other threads. */
async function arrayBytes(): Promise<number> {
  let least = Number.POSITIVE_INFINITY;
  for (let unchanged = 0; unchanged < 5; unchanged++) {
    await new Promise((resolve) => setTimeout(resolve, 10)); // releases what finished tasks used
    collectGarbage();
    const { arrayBuffers } = process.memoryUsage();
    if (arrayBuffers < least) [least, unchanged] = [arrayBuffers, 0];
  }
  return least;
}

test("Gaussians of a restored scene are held once until its file is revalidated, and then drawn", async () => {
  const caches = new Caches(),
    said: FromWorker[] = [];
  new Server((asked) => part(SCENE, asked));
  await visit(caches);
  const reception = new WorkerReceiver();
  Object.assign(globalThis, {
    Worker: Helper,
    navigator: { hardwareConcurrency: 3 },
    self: { location: { href: "" }, postMessage: (message: FromWorker) => void said.push(message) },
  });
  await reception.resume(URL_);
  await reception.settled();
  assert.ok(Helper.started > 1 && reception.complete);
  const restored = await arrayBytes();
  assert.ok(!said.some(({ kind }) => kind === "splats"));
  reception.confirmed();
  await reception.settled();
  const splats = said.flatMap((one) => (one.kind === "splats" ? [one.packed] : []));
  const packedBytes = splats.reduce((sum, { centers }) => sum + centers.buffer.byteLength, 0);
  const drawn = (await arrayBytes()) - packedBytes;
  assert.ok(packedBytes > 1e6);
  assert.ok(restored - drawn < packedBytes / 4, `${restored - drawn} bytes more`);
});
