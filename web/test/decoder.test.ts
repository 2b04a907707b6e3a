// `splatwire/decoder`: all Gaussians of levels, any frame of a clip, and one clear error for unsuitable options.

import assert from "node:assert/strict";
import { getEventListeners, once } from "node:events";
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { test } from "node:test";

import { StreamDecoder } from "../src/codec/decoder.ts";
import { BitstreamError, decode, decodeClip, type Gaussians, type ReceivedUpdate, receive } from "../src/decoder.ts";
import { Generator } from "../src/integrations/splat_transform.ts";
import { ContainerReader } from "../src/packets/container.ts";

const path = (name: string): string => `../tests/golden/${name}.swz`,
  bytesOf = (name: string): Uint8Array => new Uint8Array(readFileSync(path(name)));
const levels = bytesOf("tiny_levels"),
  clip = bytesOf("tiny_clip"),
  anchors = bytesOf("tiny_causal");

/** Number of elements in the finest level of a stream. */
function finestCount(file: Uint8Array): number {
  const container = new ContainerReader();
  container.feed(file);
  const { tiers, count } = container.head!.manifest;
  return tiers.at(-1)?.count ?? count;
}

/** Returns a file with the same head and some of the packets. */
function partOf(file: Uint8Array, keep: (n: number) => boolean): Uint8Array {
  const container = new ContainerReader(),
    packets = container.feed(file).filter((_, n) => keep(n)),
    sized = packets.flatMap((packet) => [new Uint8Array(Uint32Array.of(packet.length).buffer), packet]);
  return new Uint8Array(Buffer.concat([container.headBytes, ...sized]));
}

async function received(file: Uint8Array, options: Parameters<typeof receive>[1]): Promise<ReceivedUpdate[]> {
  const server = createServer((request, response) => response.end(request.url === "/s.swz" ? file : undefined)),
    found: ReceivedUpdate[] = [];
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  try {
    const { port } = server.address() as AddressInfo;
    for await (const arrived of receive(`http://127.0.0.1:${port}/s.swz`, options)) found.push(arrived);
  } finally {
    server.closeAllConnections();
    server.close();
  }
  return found;
}

for (const concealer of [undefined, "grow"]) {
  test(`decode returns all Gaussians of the finest level, with concealer ${concealer}`, async () => {
    const scene = await decode(levels, concealer ? { concealer } : {});
    assert.equal(scene.gaussians.count, finestCount(levels));
    assert.equal(scene.gaussians.centres.length, 3 * scene.gaussians.count);
    assert.deepEqual([scene.complete, scene.verified, scene.clip], [true, true, null]);
  });
}

test("coarser Gaussians replace a lost tile", async () => {
  const some = await decode(partOf(levels, (n) => n < 4));
  assert.ok(some.gaussians.count > 0 && some.gaussians.count < finestCount(levels));
  assert.deepEqual([some.complete, some.verified], [false, false]);
});

test("the last result of receiving levels has all Gaussians of the finest level", async () => {
  const found = await received(levels, {});
  assert.equal(found.at(-1)!.gaussians.count, finestCount(levels));
  assert.ok(found.every(({ replaces, instead }) => replaces && instead));
});

test("decode, decodeClip and receive return the same frames of a clip", async () => {
  const whole = await decodeClip(clip),
    { numFrames, rate } = whole.clip,
    last = numFrames - 1;
  assert.ok(numFrames > 1 && rate > 0 && whole.verified);
  const frames = Array.from({ length: numFrames }, (_, n) => whole.frame(n));
  assert.ok(frames.every(({ count }) => count > 0));
  const moved = (one: Gaussians, other: Gaussians): boolean =>
    !Buffer.from(one.centres.buffer).equals(Buffer.from(other.centres.buffer));
  assert.ok(moved(frames[0], frames[last]), "nothing moves");
  for (const frame of [0, last]) {
    const scene = await decode(clip, { frame, concealer: "grow" });
    assert.deepEqual(scene.gaussians, frames[frame]);
    assert.deepEqual(scene.clip, whole.clip);
    assert.deepEqual((await received(clip, { frame })).at(-1)!.gaussians, frames[frame]);
  }
  assert.deepEqual(whole.frame(last), frames[last]);
});

test("a clip is refused without a frame or with a frame out of range", async () => {
  const { numFrames } = (await decodeClip(clip)).clip;
  await assert.rejects(decode(clip), { name: "RangeError", message: /clip: choose one of its frames, 0 to / });
  for (const frame of [-1, numFrames, 0.5, Number.NaN]) {
    await assert.rejects(decode(clip, { frame }), { name: "RangeError", message: /frame .* does not exist/ });
    await assert.rejects(async () => (await decodeClip(clip)).frame(frame), RangeError);
  }
  await assert.rejects(decode(levels, { frame: 0 }), /not a clip/);
  await assert.rejects(decodeClip(levels), /not a clip/);
  await assert.rejects(received(clip, {}), /choose one of its frames/);
});

test("an unavailable concealer is refused with the names of the available ones", async () => {
  await assert.rejects(decode(levels, { concealer: "scene_free" }), /no concealer 'scene_free', only grow, drop$/);
  await assert.rejects(decode(clip, { frame: 0, concealer: "sketch" }), /only grow, motion, hold, drop$/);
  await assert.rejects(received(levels, { concealer: "sketch" }), /no concealer 'sketch'/);
});

test("anchors without a camera are refused with an error that requests one", async () => {
  await assert.rejects(decode(anchors), /neural anchors.*pass a `camera`/);
  await assert.rejects(received(anchors, {}), /neural anchors.*pass a `camera`/);
});

test("an invalid camera is refused with what it needs, and the margin may be absent", async () => {
  const viewmat = [
      [1, 0, 0, 0],
      [0, 1, 0, 0],
      [0, 0, 1, 3],
    ],
    camera = { viewmat, focal: 60, width: 64, height: 48 };
  const { gaussians } = await decode(anchors, { camera });
  assert.ok(gaussians.count > 0);
  assert.equal((await decode(anchors, { camera: { ...camera, margin: 0 } })).gaussians.count, gaussians.count);
  const wrong = [
    {},
    { ...camera, viewmat: null },
    { ...camera, viewmat: Array.from({ length: 16 }, () => 1) },
    { ...camera, viewmat: [[NaN, 0, 0, 0], viewmat[1], viewmat[2]] },
    { ...camera, width: 0 },
    { viewmat, width: 64, height: 48 },
    { ...camera, width: undefined },
    { ...camera, margin: -1 },
  ];
  for (const one of wrong) {
    const options = { camera: one } as unknown as { camera: typeof camera };
    await assert.rejects(decode(anchors, options), { name: "TypeError", message: /of a camera (is|are)/ });
    await assert.rejects(received(anchors, options), { name: "TypeError", message: /of a camera (is|are)/ });
  }
});

test("a truncated or foreign file throws BitstreamError", async () => {
  for (const file of [levels.subarray(0, 40), new Uint8Array(50)]) {
    const error = await decode(file).catch((error: unknown) => error);
    assert.ok(error instanceof BitstreamError);
    assert.equal(error.name, "BitstreamError");
  }
});

test("the bytes of a file are taken from any buffer, and other values are refused with what works", async () => {
  const { gaussians } = await decode(levels),
    buffer = levels.slice().buffer;
  for (const file of [buffer, new DataView(buffer) as unknown as ArrayBuffer])
    assert.deepEqual((await decode(file)).gaussians, gaussians);
  assert.equal((await decodeClip(clip.slice().buffer)).clip.numFrames, (await decodeClip(clip)).clip.numFrames);
  for (const file of [null, undefined, "scene.swz", {}, [1, 2], new Response("")])
    await assert.rejects(decode(file as unknown as Uint8Array), {
      name: "TypeError",
      message: /Uint8Array or an ArrayBuffer/,
    });
});

test("splat-transform receives all rows of levels, or the chosen frame of a clip", async () => {
  const given = (fields: Record<string, string>) => Object.entries(fields).map(([name, value]) => ({ name, value }));
  const generator = await Generator.create([{ name: "file", value: path("tiny_levels") }]);
  assert.equal(generator.count, finestCount(levels));
  const { count } = (await decodeClip(clip)).frame(1);
  assert.equal((await Generator.create(given({ file: path("tiny_clip"), frame: "1" }))).count, count);
  await assert.rejects(Generator.create(given({ file: path("tiny_clip") })), /choose one of its frames/);
  await assert.rejects(Generator.create(given({ file: path("tiny_clip"), frame: "one" })), /frame .* does not exist/);
});

test("splat-transform warns of antialiasing, an origin and a background, which its output lacks", async (context) => {
  const warn = context.mock.method(console, "warn", () => undefined);
  await Generator.create([{ name: "file", value: path("tiny_levels") }]);
  assert.equal(warn.mock.callCount(), 0);
  context.mock.getter(StreamDecoder.prototype, "antialiased", () => true);
  context.mock.getter(StreamDecoder.prototype, "origin", () => [0, 4e6, 0.5]);
  context.mock.getter(StreamDecoder.prototype, "background", () => [1, Math.fround(0.2), 0]);
  await Generator.create([{ name: "file", value: path("tiny_levels") }]);
  const texts = warn.mock.calls.map(({ arguments: [text] }) => String(text));
  assert.match(texts[0], /tiny_levels\.swz: the scene is antialiased/);
  assert.match(texts[1], /origin \(0, 4000000, 0\.5\)/);
  assert.match(texts[2], /background colour \(1, 0\.2, 0\) is left out/);
});

test("a signal that lives longer than a transfer keeps nothing of it", async () => {
  const { signal } = new AbortController();
  assert.ok((await received(levels, { signal })).length);
  assert.equal(getEventListeners(signal, "abort").length, 0);
});

test("an address that is not http is read as a whole if it rejects ranges", async (context) => {
  const bytes = readFileSync(path("tiny_levels"));
  context.mock.method(globalThis, "fetch", (_: string, { headers }: RequestInit) =>
    "Range" in (headers as object) ? Promise.reject(new TypeError("no ranges")) : Promise.resolve(new Response(bytes)),
  );
  for (const url of ["blob:nodedata:9", "app://localhost/scene.swz"]) {
    let numParts = 0;
    for await (const _ of receive(url)) numParts++;
    assert.ok(numParts);
  }
});

test("an address without a server is an error, and a connection that fails is named with the reason", async () => {
  for (const [url, reason] of [
    ["file:///scene.swz", "cannot be requested: its address does not begin with http"],
    ["localhost:8000/scene.swz", "cannot be requested: its address does not begin with http"],
    ["ftp://localhost/scene.swz", "cannot be requested: its address does not begin with http"],
    ["blob:nodedata:9", "cannot be requested: its blob was revoked"],
  ])
    await assert.rejects(
      async () => {
        for await (const _ of receive(url, { lost: assert.fail })) assert.fail();
      },
      new RegExp(`${url} ${reason}`),
    );
  const server = createServer().listen(0, "127.0.0.1");
  await once(server, "listening");
  const { port } = server.address() as AddressInfo,
    stop = new AbortController(),
    reasons: string[] = [];
  server.close();
  await once(server, "close");
  const lost = (reason: string): void => {
      reasons.push(reason);
      stop.abort();
    },
    options = { signal: stop.signal, lost };
  await assert.rejects(async () => {
    for await (const _ of receive(`http://127.0.0.1:${port}/s.swz`, options)) assert.fail();
  }, /abort/);
  assert.match(reasons[0], /^fetch failed: .*ECONNREFUSED/);
});
