import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import type { AnchorBatch } from "../src/codec/anchor_batch.ts";
import { StreamDecoder } from "../src/codec/decoder.ts";
import type { ElementBatch } from "../src/codec/element_batch.ts";
import { GaussianBatch } from "../src/codec/gaussians/gaussian_batch.ts";
import type { Splats } from "../src/codec/splats.ts";
import { ANCHOR_CONCEALERS, CONCEALERS, SPLAT_CONCEALERS } from "../src/conceal/conceal.ts";
import { grow } from "../src/conceal/grow.ts";
import { KdTree } from "../src/conceal/kd_tree.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { CAMERA } from "./hostile.ts";
import { random, readStream, STREAMS } from "./vectors.ts";

const next = random(3),
  points = Float32Array.from({ length: 3 * 400 }, () => Math.round(next() * 60));
const indices = Int32Array.from({ length: 400 }, (_, i) => i);
const always = (): Promise<boolean> => Promise.resolve(true);

test("nearest neighbours equal those of an exhaustive search", () => {
  const tree = new KdTree(points, 9);
  for (let i = 0; i < 400; i += 7) {
    const far = (j: number): number =>
      [0, 1, 2].reduce((sum, a) => sum + (points[3 * i + a] - points[3 * j + a]) ** 2, 0);
    const all = Array.from({ length: 400 }, (_, j) => j)
      .filter((j) => j !== i)
      .map(far)
      .sort((a, b) => a - b)
      .slice(0, 9);
    assert.deepEqual(
      [...tree.nearestOthers(i)].map(far).sort((a, b) => a - b),
      all,
    );
  }
});

test("gains are 1 without losses and increase with the lost share", async () => {
  const sizes = new Float32Array(400).fill(2),
    opacities = new Float32Array(400).fill(0.3),
    isReceived = new Uint8Array(400).fill(1);
  assert.ok(
    (await grow(
      { positions: points, sizes, tierSizes: null, opacities, isReceived, indices, logScales: null, anchors: null },
      always,
    ))!.every((gain) => gain === 1),
  );
  for (let i = 0; i < 400; i += 2) isReceived[i] = 0;
  const gains = (await grow(
      { positions: points, sizes, tierSizes: null, opacities, isReceived, indices, logScales: null, anchors: null },
      always,
    ))!,
    most = (1.08 * Math.SQRT2) ** 2;
  for (let i = 0; i < 400; i++) {
    const [size, opacity] = gains.subarray(2 * i, 2 * i + 2);
    assert.ok(
      isReceived[i]
        ? size >= 1 && size <= most ** 0.12 + 1e-6 && opacity >= 1 && opacity * 0.3 < 1
        : size === 1 && opacity === 1,
    );
  }
  assert.ok(gains.some((gain, i) => i % 2 === 0 && gain > 1.05));
});

test("lost elements of small tiers cause less growth than their number suggests", async () => {
  const isReceived = Uint8Array.from({ length: 400 }, (_, i) => i % 2),
    sizes = new Float32Array(400).fill(1);
  const small = sizes.map((_, i) => (isReceived[i] ? 1 : 1 / 16)),
    all = { positions: points, sizes, opacities: null, isReceived, indices, logScales: null, anchors: null };
  const gains = (await grow({ ...all, tierSizes: small }, always))!,
    heads = (await grow({ ...all, tierSizes: null }, always))!;
  assert.deepEqual([...heads], [...(await grow({ ...all, tierSizes: sizes }, always))!]);
  const most = 1.08 * (16 / 17) ** -0.5;
  for (let i = 1; i < 400; i += 2)
    assert.ok(
      gains[2 * i] >= 1 && gains[2 * i] <= most + 1e-6 && heads[2 * i] > gains[2 * i] && gains[2 * i - 2] === 1,
    );
});

test("a concealer stops once its result is no longer needed", async () => {
  const isReceived = Uint8Array.from({ length: 400 }, (_, i) => i % 2);
  assert.equal(
    await grow(
      {
        positions: points,
        sizes: new Float32Array(400).fill(1),
        tierSizes: null,
        opacities: new Float32Array(400).fill(0.5),
        isReceived,
        indices,
        logScales: null,
        anchors: null,
      },
      () => Promise.resolve(false),
    ),
    null,
  );
  assert.deepEqual(Object.keys(CONCEALERS), ["drop", "grow"]);
  for (const all of [SPLAT_CONCEALERS, ANCHOR_CONCEALERS])
    assert.deepEqual(Object.keys(all), ["drop", "grow", "scene_free"]);
});

const GROW = { concealer: "grow", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };
type Gains = Record<string, Record<string, number[]>>;
const expected = process.env["EXPECTED"]
  ? (JSON.parse(readFileSync(process.env["EXPECTED"], "utf8")) as { gains: Gains; copies: Record<string, number[]> })
  : null;

test("gains equal Python's", { skip: expected === null && "EXPECTED is not set" }, async () => {
  for (const [path, all] of Object.entries(expected!.gains)) {
    const { head, packets } = readStream(path),
      received = new DecodedStream(head);
    for (const bytes of packets.filter((_, n) => n % 2 === 0)) received.addPacket(bytes);
    assert.deepEqual(Object.keys(received.decoder.elementDecoder.concealers), ["drop", ...Object.keys(all)]);
    for (const [concealer, gains] of Object.entries(all)) {
      await received.prepare({ ...GROW, concealer }, always);
      assert.equal(await received.conceal({ ...GROW, concealer }, always), Math.ceil(packets.length / 2));
      const found = received.gains!,
        off = found.map((gain, i) => (gains[i] ? Math.abs(gain / gains[i] - 1) : gain)).sort();
      assert.equal(found.length, gains.length);
      const most = off[off.length - 1],
        mean = off.reduce((sum, value) => sum + value, 0) / off.length;
      // Anchors lie on a grid, so either of two equally distant ones may be the last of the 64.
      assert.ok(
        received.decoder.elementDecoder.viewDependent ? most < 0.05 && mean < 0.001 : most < 1e-5,
        `${path} ${concealer}: ${most}, ${mean}`,
      );
    }
  }
});

test("redundant copies equal Python's", {
  skip: expected === null && "EXPECTED is not set",
}, async () => {
  for (const [path, numbers] of Object.entries(expected!.copies)) {
    const { batch } = (await new StreamDecoder(readStream(path).head).elementDecoder.copies(always))!,
      found = numbersOf(batch);
    assert.equal(found.length, numbers.length);
    const off = found.map((number, n) => Math.abs(number - numbers[n]) / Math.max(Math.abs(numbers[n]), 1e-3));
    assert.ok(
      off.every((value) => value < 1e-4),
      `${path}: ${Math.max(...off)}`,
    );
  }
});

/** Numbers of redundant copies as listed by `tests/web/sketched.py`. */
function numbersOf(batch: ElementBatch): number[] {
  if (batch instanceof GaussianBatch)
    return [batch.splats.means, batch.splats.scales, batch.splats.quats, batch.splats.opacities].flatMap((values) => [
      ...values,
    ]);
  const {
    anchors: { positions, sizes, scales, offsets, masks, numOffsets },
    features,
  } = batch as AnchorBatch;
  const far = offsets.map((offset, n) => offset * scales[Math.floor(n / 3 / numOffsets)] * masks[Math.floor(n / 3)]);
  return [positions, features!, sizes, far].flatMap((values) => [...values]);
}

for (const path of STREAMS) {
  test(`late packets of ${path.split("/").pop()} fill their gaps`, async () => {
    const { head, packets } = readStream(path),
      received = new DecodedStream(head),
      whole = new DecodedStream(head);
    for (const bytes of packets.filter((_, n) => n % 2 === 0)) received.addPacket(bytes);
    const first = await received.gaussiansFor(CAMERA, true, always);
    await received.conceal({ ...GROW, lossRate: 0.3, seed: 1 }, always);
    for (const bytes of packets) received.addPacket(bytes);
    const second = (await received.gaussiansFor(CAMERA, false, always))!;
    for (const bytes of packets) whole.addPacket(bytes);
    const all = (await whole.gaussiansFor(CAMERA, true, always))!,
      count = (parts: readonly Splats[]): number => parts.reduce((sum, part) => sum + part.count, 0);
    assert.ok(second.hasNew || packets.length === 1);
    assert.equal(count(first!.parts) + count(second.parts), count(all.parts));
    assert.equal(second.elements, head.manifest.count);
    assert.equal(await received.conceal(GROW, always), packets.length);
    assert.equal(received.gains!.length, 2 * count(all.parts));
    assert.ok(received.gains!.every((gain) => gain === 1));
  });
}

/** Streams with redundant copies for the concealer `sketch`. */
const COPIED = STREAMS.filter((path) => "sketch" in new StreamDecoder(readStream(path).head).elementDecoder.concealers);

test("redundant copies are hidden and not counted in a complete scene", {
  skip: !COPIED.length && "STREAMS has no stream with redundant copies",
}, async () => {
  const simulation = { ...GROW, concealer: "sketch" },
    countOf = (parts: readonly { count: number }[]): number => parts.reduce((sum, { count }) => sum + count, 0);
  for (const path of COPIED) {
    const { head, packets } = readStream(path),
      received = new DecodedStream(head);
    for (const bytes of packets) received.addPacket(bytes);
    const plain = (await received.gaussiansFor(CAMERA, true, always))!;
    assert.equal(plain.copies, 0);
    assert.equal(received.gainsWithoutCopies, null);
    await received.prepare(simulation, always);
    const copied = (await received.gaussiansFor(CAMERA, false, always))!,
      again = (await received.gaussiansFor(CAMERA, true, always))!;
    assert.equal(copied.copies, countOf(copied.parts));
    assert.equal(countOf(again.parts) - again.copies, countOf(plain.parts));
    await received.conceal(simulation, always);
    assert.deepEqual(received.gains, received.gainsWithoutCopies);
  }
});
