// Updates of Python, applied in the page's code, give the Gaussians of Python's result, or one error
// (tests/web/test_updates.py).

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import type { GaussianSchema } from "../src/codec/gaussians/schema.ts";
import type { Splats } from "../src/codec/splats.ts";
import { headerOf, readRemoved, readUpdate } from "../src/codec/update/update.ts";
import { UpdatedScene } from "../src/codec/update/updated_scene.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { fileManifest, manifestDigest, updateUrl } from "../src/transport/updates.ts";
import { spoiled } from "./hostile.ts";
import { random } from "./vectors.ts";

interface Chain {
  readonly states: readonly string[];
  readonly updates: readonly string[];
  readonly masks: readonly { readonly bytes: string; readonly count: number; readonly mask: readonly number[] }[];
}

const CHAIN: Chain = JSON.parse(readFileSync(process.env["UPDATES"]!, "utf8")),
  CASES = Number(process.env["CASES"] ?? 300);
const pause = async (): Promise<boolean> => true;
const bytesOf = (path: string): Uint8Array => new Uint8Array(readFileSync(path));

function sceneOf(path: string): UpdatedScene {
  const file = bytesOf(path),
    container = new ContainerReader(),
    packets = container.feed(file),
    received = new DecodedStream(container.head!);
  for (const packet of packets) received.addPacket(packet);
  const { info } = received.decoder.schema as GaussianSchema;
  return new UpdatedScene(
    manifestDigest(fileManifest(file)),
    info,
    headerOf(container.head!.sideInfo),
    received.splats,
  );
}

/** Attributes of all Gaussians, one line each, sorted. */
function rowsOf(parts: readonly Splats[]): string[] {
  return parts
    .flatMap((part) =>
      Array.from({ length: part.count }, (_, n) =>
        [part.means, part.quats, part.scales, part.opacities, part.colours, part.harmonics]
          .map((values) => {
            const width = values.length / part.count;
            return values.subarray(n * width, (n + 1) * width).join();
          })
          .join(),
      ),
    )
    .sort();
}

test("updates that follow each other lead to the scenes of Python", async () => {
  const scene = sceneOf(CHAIN.states[0]);
  let drawn = scene.count;
  for (const [n, path] of CHAIN.updates.entries()) {
    const expected = sceneOf(CHAIN.states[n + 1]),
      update = await readUpdate(bytesOf(path), pause),
      before = scene.count,
      { hidden, splats } = scene.apply(update),
      added = splats.reduce((sum, { count }) => sum + count, 0);
    assert.deepEqual(rowsOf(scene.visibleParts()), rowsOf(expected.visibleParts()));
    assert.equal(scene.digest, expected.digest);
    assert.equal(scene.count, before - hidden.length + added);
    assert.ok(hidden.every((index, i) => index < drawn && (i === 0 || index > hidden[i - 1])));
    drawn += added;
    assert.equal(scene.numHidden, drawn - scene.count);
    if (n === 1) drawn -= scene.numHidden;
    if (n === 1) assert.deepEqual(rowsOf(scene.compact()), rowsOf(expected.visibleParts()));
  }
});

test("updates of another scene change nothing", async () => {
  const scene = sceneOf(CHAIN.states[0]),
    before = rowsOf(scene.visibleParts()),
    update = await readUpdate(bytesOf(CHAIN.updates[1]), pause),
    { digest } = scene;
  assert.throws(() => scene.apply(update), /changes another scene/);
  assert.throws(() => scene.apply({ ...update, baseDigest: digest, header: "" }), /quantisation steps/);
  assert.deepEqual(rowsOf(scene.visibleParts()), before);
  assert.equal(scene.digest, digest);
  await assert.rejects(readUpdate(bytesOf(CHAIN.states[0]), pause), /it is not an update/);
});

test("masks of removed Gaussians are those of Python", () => {
  for (const { bytes, count, mask } of CHAIN.masks)
    assert.deepEqual([...readRemoved(Buffer.from(bytes, "hex"), count)], mask);
});

test("updates lie beside the file of their scene", () => {
  const digest = "0123456789abcdef".repeat(4);
  assert.equal(
    updateUrl("https://host/streams/room.swz?tag", digest),
    "https://host/streams/update.0123456789abcdef.swz",
  );
});

test("mutated updates give the changed scene or one error", async () => {
  const next = random(5),
    file = bytesOf(CHAIN.updates[0]),
    expected = rowsOf(sceneOf(CHAIN.states[1]).visibleParts());
  let errors = 0;
  for (let n = 0; n < CASES; n++) {
    const scene = sceneOf(CHAIN.states[0]);
    try {
      scene.apply(await readUpdate(spoiled(file, next), pause));
    } catch (error) {
      assert.ok(error instanceof BitstreamError, String(error));
      errors++;
      continue;
    }
    assert.deepEqual(rowsOf(scene.visibleParts()), expected);
  }
  assert.ok(errors > CASES / 2);
});

test("mutated lists of removed Gaussians are a mask or one error", () => {
  const next = random(6);
  for (let n = 0; n < 20 * CASES; n++) {
    const { bytes, count } = CHAIN.masks[n % CHAIN.masks.length];
    try {
      assert.equal(readRemoved(spoiled(new Uint8Array(Buffer.from(bytes, "hex")), next), count).length, count);
    } catch (error) {
      assert.ok(error instanceof BitstreamError, String(error));
    }
  }
});
