import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { COLUMNS } from "../src/codec/gaussians/layout.ts";
import { FastPackets, NativePackets } from "../src/codec/gaussians/native.ts";
import { SOURCE_DIGEST } from "../src/codec/gaussians/native_module.ts";
import { type Decoded, PacketDecoder } from "../src/codec/gaussians/packet.ts";
import { readSideInfo, type SideInfo } from "../src/codec/gaussians/side_info.ts";
import { convert } from "../src/codec/gaussians/to_splats.ts";
import { emptySplats } from "../src/codec/splats.ts";
import { Intake, planOf } from "../src/packets/plan.ts";
import { anySideInfo, randomNumbers } from "./side_info.ts";
import { readStream, STREAMS } from "./vectors.ts";

/** Checks the integers of both decoders, and the Gaussians of the first one. */
function assertSame(native: Decoded, plain: Decoded, info: SideInfo, block: number): void {
  const splats = emptySplats(native.rows.length / COLUMNS, info.degree);
  assert.deepEqual(native.splats, convert(native, info, block, splats));
  assert.deepEqual(
    native.rows,
    plain.rows.map((value) => value + 0),
  ); // without negative zeros
  assert.deepEqual(native.harmonics, plain.harmonics);
}

test("the WebAssembly module is compiled from its source", () => {
  const source = readFileSync(new URL("native/gaussians.c", `file://${process.cwd()}/`));
  assert.equal(createHash("sha256").update(source).digest("hex"), SOURCE_DIGEST, "run: npm run native");
});

for (const path of STREAMS) {
  const { head, packets } = readStream(path);
  if (head.manifest.codec !== "gaussians") continue;
  test(`WebAssembly decodes ${path.split("/").pop()} to the same integers as plain TypeScript`, () => {
    const plan = planOf(head.manifest),
      intake = new Intake(plan),
      info = readSideInfo(head.sideInfo, plan.numBlocks),
      native = NativePackets.of(info)!,
      plain = new PacketDecoder(info);
    for (const bytes of packets) {
      const { payload, block, count } = intake.offer(bytes)!;
      assertSame(native.decode(payload, block, count), plain.decode(payload, block, count), info, block);
    }
  });
}

test("a decoder that grows keeps its instance while its tables stay", () => {
  const random = randomNumbers(3),
    first = anySideInfo(random),
    payload = Uint8Array.from({ length: 500 }, () => random(256)),
    packets = new FastPackets(first),
    { Instance } = WebAssembly;
  let made = 0;
  WebAssembly.Instance = class extends Instance {
    constructor(module: WebAssembly.Module, imports?: WebAssembly.Imports) {
      super(module, imports);
      made++;
    }
  };
  try {
    packets.decode(payload, 0, 20);
    for (let group = 1; group < 6; group++) {
      const defaults = first.defaults.map((value) => value + group);
      packets.grow({ ...first, defaults, models: first.models.slice() });
      assertSame(
        packets.decode(payload, 0, 20),
        new PacketDecoder(packets.info).decode(payload, 0, 20),
        packets.info,
        0,
      );
    }
    assert.equal(made, 1);
    const other = anySideInfo(random);
    packets.grow(other);
    assertSame(packets.decode(payload, 0, 20), new PacketDecoder(other).decode(payload, 0, 20), other, 0);
    assert.equal(made, 2);
    for (const name of ["bases", "scales", "models", "transform"] as const) {
      const before = packets.info;
      packets.grow({ ...before, [name]: before[name].map((value, n) => (n ? value : value ^ 1)) });
      packets.decode(payload, 0, 20);
      packets.grow(before);
      packets.decode(payload, 0, 20);
    }
    assert.equal(made, 2 + 8 - 2 * Number(!other.transform.length));
  } finally {
    WebAssembly.Instance = Instance;
  }
});

test("the 64-bit integers of WebAssembly are the numbers of its rows", () => {
  const random = randomNumbers(2),
    native = NativePackets.of(anySideInfo(random))!,
    payload = Uint8Array.from({ length: 3000 }, () => random(256));
  for (const count of [1, 2, 7, 300]) {
    const { rows, integers } = native.decode(payload, 0, count, true),
      view = new DataView(integers!.buffer, integers!.byteOffset, integers!.byteLength);
    assert.deepEqual(
      Array.from(rows),
      Array.from(rows, (_, n) => Number(view.getBigInt64(8 * n, true))),
    );
  }
});

test("WebAssembly and plain TypeScript decode any bytes to the same integers", () => {
  const random = randomNumbers(1);
  for (let trial = 0; trial < 60; trial++) {
    const info = anySideInfo(random),
      native = NativePackets.of(info)!,
      plain = new PacketDecoder(info);
    for (let packet = 0; packet < 8; packet++) {
      const payload = Uint8Array.from({ length: random(400) }, () => random(256)),
        count = 1 + random(random(4) ? 40 : 300);
      assertSame(native.decode(payload, 0, count), plain.decode(payload, 0, count), info, 0);
    }
  }
});
