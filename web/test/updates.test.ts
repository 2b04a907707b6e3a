// Updates of Python, applied in the page's code, give the Gaussians of Python's result, or one error
// (tests/web/test_updates.py).

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { mock, test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import type { GaussianDecoder } from "../src/codec/gaussians/gaussian_decoder.ts";
import type { Splats } from "../src/codec/splats.ts";
import { headerOf, readRemoved, readUpdate } from "../src/codec/update/update.ts";
import { UpdatedScene } from "../src/codec/update/updated_scene.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { fileManifest, manifestDigest, updateUrl } from "../src/transport/updates.ts";
import type { WorkerReceiver } from "../src/worker_receiver.ts";
import { flipped, part, Server, URL_, visit } from "./fake_web.ts";
import { spoiled } from "./hostile.ts";
import { random } from "./vectors.ts";

interface Chain {
  readonly states: readonly string[];
  readonly updates: readonly string[];
  readonly larger: string;
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
  const { info } = received.decoder.elementDecoder as GaussianDecoder;
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

test("gains of the scene before its updates are those of the Gaussians that stay", async () => {
  const scene = sceneOf(CHAIN.states[0]),
    meansOf = (parts: readonly Splats[]): string[] =>
      parts.flatMap(({ count, means }) =>
        Array.from({ length: count }, (_, n) => means.subarray(3 * n, 3 * n + 3).join()),
      ),
    before = Float32Array.from({ length: 2 * scene.count }, (_, n) => 2 + n),
    gainOf = new Map(meansOf(scene.visibleParts()).map((means, n) => [means, before[2 * n]])),
    { splats } = scene.apply(await readUpdate(bytesOf(CHAIN.updates[0]), pause)),
    added = splats.reduce((sum, { count }) => sum + count, 0),
    gains = scene.gainsOfDrawn(before);
  assert.deepEqual(gains.subarray(0, before.length), before);
  assert.deepEqual(gains.subarray(before.length), new Float32Array(2 * added).fill(1));
  const means = meansOf(scene.compact()),
    compacted = scene.gainsOfDrawn(before),
    kept = means.length - added;
  for (let n = 0; n < means.length; n++)
    if (compacted[2 * n] !== 1 && means.indexOf(means[n]) === means.lastIndexOf(means[n]))
      assert.equal(compacted[2 * n], gainOf.get(means[n]));
  assert.ok(compacted.subarray(0, 2 * kept).every((gain) => gain > 1));
  assert.deepEqual(compacted.subarray(2 * kept), new Float32Array(2 * added).fill(1));
});

/** Address of a scene on the servers of splatwire, and with the tag of its first content. */
const SCENE = "https://scenes.example/streams/a.swz",
  TAGGED = `${SCENE}?0123456789abcdef`;

/** Ends the requests for updates, and the mocks. */
async function ended(reception: WorkerReceiver): Promise<void> {
  reception.changed();
  for (let n = 0; n < 10; n++) {
    await new Promise((resolve) => setImmediate(resolve));
    mock.timers.tick(60_000);
  }
  mock.restoreAll();
  mock.timers.reset();
}

/**
 * Answers requests for the updates of the scene `states[0]`; counts those for the scene, whose file is now `replaced`.
 */
async function followed(
  answers: (update: Uint8Array, n: number) => Uint8Array,
  replaced = CHAIN.states[1],
): Promise<[readonly FromWorker[], number]> {
  const file = bytesOf(CHAIN.states[0]),
    update = bytesOf(CHAIN.updates[0]),
    name = updateUrl(TAGGED, manifestDigest(fileManifest(file))),
    server = new Server((asked) => part(file, asked)),
    { reception, said, complete } = await visit();
  assert.ok(complete);
  let updates = 0,
    scenes = 0;
  mock.method(globalThis, "fetch", async (url: string) => {
    if (url === SCENE) scenes++;
    if (url === SCENE) return new Response(readFileSync(replaced));
    if (url !== name) return new Response(null, { status: 404 });
    return new Response(answers(update, updates++) as Uint8Array<ArrayBuffer>);
  });
  mock.timers.enable({ apis: ["setTimeout"] });
  void reception.follow(TAGGED);
  for (let n = 0; n < 1e6 && !said.some(({ kind }) => kind === "update"); n++) {
    await new Promise((resolve) => setImmediate(resolve));
    mock.timers.tick(500);
  }
  assert.ok(said.some(({ kind }) => kind === "update"));
  await reception.conceal({
    kind: "conceal",
    simulation: { concealer: "drop", lossRate: 0.5, burstLength: 1, seed: 3, sentShare: 1 },
    requestId: 1,
  });
  await ended(reception);
  assert.ok(server.asked.length);
  return [said, scenes];
}

test("updates are requested only while the page wants them", async () => {
  const file = bytesOf(CHAIN.states[0]),
    server = new Server((asked) => part(file, asked)),
    { reception, complete } = await visit();
  assert.ok(complete && server.asked.length);
  let requests = 0;
  mock.method(globalThis, "fetch", async () => {
    requests++;
    return new Response(null, { status: 404 });
  });
  mock.timers.enable({ apis: ["setTimeout"] });
  for (const [wanted, expected] of [
    ["", 0],
    [URL_, 5],
    ["", 5],
    [URL_, 10],
  ] as const) {
    void reception.follow(wanted);
    for (let seconds = 0; seconds < 5; seconds++) {
      mock.timers.tick(1000);
      await new Promise((resolve) => setImmediate(resolve));
    }
    assert.equal(requests, expected);
  }
  await ended(reception);
});

test("a scene without a server has no updates, which is said once", async () => {
  const file = bytesOf(CHAIN.states[0]),
    address = "blob:https://scenes.example/f3a1",
    server = new Server((asked) => part(file, asked)),
    { reception, said, complete } = await visit(null, { file: address });
  assert.ok(complete && server.asked.length);
  mock.timers.enable({ apis: ["setTimeout"] });
  void reception.follow(address);
  await ended(reception);
  assert.deepEqual(
    said.filter(({ kind }) => kind === "updatemissed"),
    [{ kind: "updatemissed", reason: "only scenes on a server have updates" }],
  );
});

test("an update that arrives after the page wants no more is not applied", async () => {
  const file = bytesOf(CHAIN.states[0]),
    server = new Server((asked) => part(file, asked)),
    { reception, said, complete } = await visit();
  assert.ok(complete && server.asked.length);
  let answered = false;
  mock.method(globalThis, "fetch", async () => {
    if (!answered) await reception.follow("");
    answered = true;
    return new Response(readFileSync(CHAIN.updates[0]));
  });
  mock.timers.enable({ apis: ["setTimeout"] });
  void reception.follow(URL_);
  for (let n = 0; n < 50; n++) {
    await new Promise((resolve) => setImmediate(resolve));
    mock.timers.tick(500);
  }
  assert.ok(answered && !said.some(({ kind }) => kind === "update"));
  await ended(reception);
});

test("a damaged update is requested again, and the whole scene after the third one", async () => {
  const damaged = (update: Uint8Array): Uint8Array => flipped(update, update.length - 9),
    [said, scenes] = await followed((update, n) => (n < 2 ? damaged(update) : update));
  assert.equal(scenes, 0);
  assert.equal(said.filter(({ kind }) => kind === "updatemissed").length, 1);
  const [others, requests] = await followed(damaged),
    message = others.find(({ kind }) => kind === "update") as FromWorker & { kind: "update" };
  assert.equal(requests, 1);
  assert.equal(message.hidden, null);
});

test("a scene that has grown, as in a training, replaces the one before in the same unit of length", async () => {
  const damaged = (update: Uint8Array): Uint8Array => flipped(update, update.length - 9),
    [said] = await followed(damaged, CHAIN.larger),
    info = said.find(({ kind }) => kind === "info") as FromWorker & { kind: "info" },
    { hidden, packed } = said.find(({ kind }) => kind === "update") as FromWorker & { kind: "update" },
    scene = sceneOf(CHAIN.larger),
    means = scene.visibleParts().flatMap((part) => [...part.means]);
  assert.equal(2 ** scene.info.sizeLog, 4 * info.info.size);
  assert.equal(hidden, null);
  assert.deepEqual(
    [...packed.centers].filter((_, n) => n % 4 < 3),
    means.map((value) => Math.fround(value / info.info.size)),
  );
});

test("simulated losses have an effect after an update, too", async () => {
  const [said] = await followed((update) => update),
    answer = said.find(({ kind }) => kind === "gains") as FromWorker & { kind: "gains" },
    lost = answer.gains.filter((gain, n) => n % 2 === 0 && gain === 0).length,
    count = sceneOf(CHAIN.states[0]).count;
  assert.ok(lost > count / 5 && lost < (4 * count) / 5, `${lost} of ${count}`);
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

test("updates lie beside the file of their scene, with its query", () => {
  const digest = "0123456789abcdef".repeat(4);
  assert.equal(
    updateUrl("https://host/streams/room.swz?tag", digest),
    "https://host/streams/update.0123456789abcdef.swz?tag",
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
