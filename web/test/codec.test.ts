import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { BitstreamError } from "../src/bytes.ts";
import { EXISTS, exactExists, exactSixteenths, powers, SIXTEENTHS } from "../src/codec/causal/tables.ts";
import { StreamDecoder } from "../src/codec/decoder.ts";
import { exactFlatness, flatnessTable } from "../src/codec/gaussians/tables.ts";
import { readPreview } from "../src/codec/preview.ts";
import { type TierLayout, tierLayout } from "../src/codec/tiers.ts";
import { HALF_WIDTHS, INVERSE_SCALES, NORMAL } from "../src/entropy/tables.ts";
import type { Camera } from "../src/model/camera.ts";
import type { Manifest } from "../src/packets/manifest.ts";
import { splitmixModulo } from "../src/packets/splitmix64.ts";
import { sha256 } from "../src/sha256.ts";
import { readStream, STREAMS } from "./vectors.ts";

/** Answers of the Python decoder, if available. */
const expected = process.env["EXPECTED"]
  ? (JSON.parse(readFileSync(process.env["EXPECTED"], "utf8")) as Expected)
  : null;

interface Expected {
  tables: Record<string, string>;
  lanes: [string, number, number, number][];
  splats: Record<string, number[][]>;
  camera: Camera;
  preview: { bytes: string; numbers: number[] };
}

for (const path of STREAMS) {
  test(`all integers of ${path.split("/").pop()} equal Python's`, async () => {
    const { head, packets } = readStream(path),
      decoder = new StreamDecoder(head);
    for (const bytes of packets) assert.ok(decoder.addPacket(bytes));
    assert.ok(decoder.intake.complete);
    assert.equal(await decoder.digest(), head.manifest.symbolsDigest);
  });
}

test("the tier_sizes section has one byte per tier, and one of them is 0", () => {
  const facts = (shapes: number[], ...sizes: number[]): TierLayout => {
    const sections = new Map([["tier_sizes", Uint8Array.from(sizes)]]),
      tiers = shapes.map((count) => ({ count, lanes: 1 }));
    if (tiers.length) sections.set("tiers", new Uint8Array(4));
    return tierLayout(sections, { tiers, count: 3 } as unknown as Manifest);
  };
  assert.deepEqual(facts([0, 3], 0, 12).sizes, new Float32Array(3).fill(2 ** -1.5));
  for (const [shapes, sizes] of [
    [[], [0]],
    [[1, 2], []],
    [[1, 2], [0]],
    [
      [1, 2],
      [0, 1, 2],
    ],
    [
      [1, 2],
      [1, 1],
    ],
  ]) {
    assert.throws(
      () => facts(shapes, ...sizes),
      (error) => error instanceof BitstreamError && error.message.includes("tier_sizes"),
    );
  }
});

test("no entry of the scale ratio table is near a rounding boundary", () => {
  for (let t = 1; t < flatnessTable().length; t++) {
    const exact = exactFlatness(t),
      nearest = Math.abs(exact - Math.round(exact));
    assert.ok(nearest > 1e-6, `${t}: ${exact}`);
  }
});

test("no entry of the causal codec's tables is near a rounding boundary", () => {
  const near = (exact: number, edge: number): number => Math.abs(exact - edge - Math.round(exact - edge));
  for (let n = 0; n < 256; n++) {
    assert.ok(near(exactExists(n), 0.5) > 1e-6 && (n === 0 || near(exactSixteenths(n), 0) > 1e-6), `${n}`);
  }
});

test("integer tables equal Python's", { skip: expected === null && "EXPECTED is not set" }, () => {
  const digest = (values: Int32Array | Float64Array): string => sha256(new TextEncoder().encode(values.join(",")));
  const tables = {
    normal: NORMAL,
    inverse: INVERSE_SCALES,
    widths: HALF_WIDTHS,
    flatness: flatnessTable(),
    sixteenths: SIXTEENTHS,
    powers: powers(),
    exists: EXISTS,
  };
  for (const [name, values] of Object.entries(tables)) assert.equal(digest(values), expected!.tables[name], name);
});

test("lane assignments equal Python's", { skip: expected === null && "EXPECTED is not set" }, () => {
  for (const [seed, rank, lanes, lane] of expected!.lanes) {
    const wide = BigInt(seed),
      low = Number(wide & 0xffffffffn),
      high = Number(wide >> 32n);
    assert.equal(splitmixModulo((rank ^ low) >>> 0, high, lanes), lane);
  }
});

test("Gaussians equal Python's to six digits", {
  skip: expected === null && "EXPECTED is not set",
}, () => {
  for (const path of STREAMS) {
    const { head, packets } = readStream(path),
      decoder = new StreamDecoder(head),
      camera = expected!.camera;
    const { splats } = decoder.addPacket(packets[0])!.forCamera(camera),
      rows = expected!.splats[path],
      number = 3 * ((splats.degree + 1) ** 2 - 1);
    assert.equal(splats.count, rows.length);
    rows.forEach((row, i) => {
      const found = [
        ...splats.means.subarray(3 * i, 3 * i + 3),
        ...splats.quats.subarray(4 * i, 4 * i + 4),
        ...splats.scales.subarray(3 * i, 3 * i + 3),
        splats.opacities[i],
        ...splats.colours.subarray(3 * i, 3 * i + 3),
        ...splats.harmonics.subarray(number * i, number * (i + 1)),
      ];
      assert.equal(found.length, row.length);
      found.forEach((value, n) =>
        assert.ok(
          Math.abs(value - row[n]) <=
            2e-6 * Math.max(Math.abs(row[n]), 1e-3) + (n < 7 || n > 10 ? 2e-6 : n === 10 ? 5e-7 : 0),
          `${i} ${n}: ${value} ${row[n]}`,
        ),
      );
    });
  }
});

test("a preview decodes as in Python", { skip: expected === null && "EXPECTED is not set" }, () => {
  const { splats } = readPreview(Uint8Array.from(Buffer.from(expected!.preview.bytes, "hex")));
  const found = [...splats.means, ...splats.scales, ...splats.opacities, ...splats.colours];
  found.forEach((value, n) =>
    assert.ok(Math.abs(value - expected!.preview.numbers[n]) <= 1e-5 * Math.max(Math.abs(value), 1)),
  );
});
