import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { COLUMNS } from "../src/codec/gaussians/layout.ts";
import { compressFast, countLanesFast, FastPacketDecoder, NativePacketDecoder } from "../src/codec/gaussians/native.ts";
import { SOURCE_DIGEST } from "../src/codec/gaussians/native_module.ts";
import { type Decoded, PacketDecoder } from "../src/codec/gaussians/packet.ts";
import { readSideInfo, type SideInfo } from "../src/codec/gaussians/side_info.ts";
import { convert } from "../src/codec/gaussians/to_splats.ts";
import { emptySplats } from "../src/codec/splats.ts";
import { HEADER_FIELDS, NUM_CHANNELS, NUM_CONTEXTS, STATE } from "../src/codec/tracks/layout.ts";
import {
  FastMotionPacketDecoder,
  type MotionPacket,
  NativeMotionPacketDecoder,
  PlainMotionPacketDecoder,
  type TrackKeyframes,
} from "../src/codec/tracks/motion_packets.ts";
import type { SequenceInfo } from "../src/codec/tracks/side_info.ts";
import { countLanes, Intake, planOf } from "../src/packets/plan.ts";
import { BLOCK, compress } from "../src/sha256.ts";
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

test("the WebAssembly module is compiled from its source, with the options of the script", () => {
  const digest = createHash("sha256");
  for (const path of ["native/gaussians.c", "scripts/native.mjs"])
    digest.update(readFileSync(new URL(path, `file://${process.cwd()}/`)));
  assert.equal(digest.digest("hex"), SOURCE_DIGEST, "run: npm run native");
});

for (const path of STREAMS) {
  const { head, packets } = readStream(path);
  if (head.manifest.codec !== "gaussians") continue;
  test(`WebAssembly decodes ${path.split("/").pop()} to the same integers as plain TypeScript`, () => {
    const plan = planOf(head.manifest),
      intake = new Intake(plan),
      info = readSideInfo(head.sideInfo, plan.numBlocks),
      native = NativePacketDecoder.of(info)!,
      plain = new PacketDecoder(info);
    for (const bytes of packets) {
      const { payload, block, count } = intake.offer(bytes)!;
      assertSame(native.decode(payload, block, count), plain.decode(payload, block, count), info, block);
    }
  });
}

test("lanes are counted and blocks are hashed by one instance, in WebAssembly", () => {
  const { Instance } = WebAssembly,
    calls: string[] = [];
  WebAssembly.Instance = class extends Instance {
    constructor(module: WebAssembly.Module, imports?: WebAssembly.Imports) {
      super(module, imports);
      const { exports } = new Instance(module, imports),
        told = Object.entries(exports).map(([name, value]) => {
          if (typeof value !== "function") return [name, value];
          const called = (...given: number[]): unknown => {
            calls.push(name);
            return value(...given);
          };
          return [name, called];
        });
      Object.defineProperty(this, "exports", { value: Object.fromEntries(told) });
    }
  };
  try {
    const state = new Int32Array(8),
      other = new Int32Array(8),
      blocks = Uint8Array.from({ length: 3 * BLOCK }, (_, n) => n);
    assert.deepEqual(countLanesFast(5, 100, [1, 2], 7), countLanes(5, 100, [1, 2], 7));
    compressFast(state, blocks);
    compress(other, blocks);
    assert.deepEqual(state, other);
  } finally {
    WebAssembly.Instance = Instance;
  }
  assert.deepEqual(calls, ["begin", "lanes", "begin", "hash"]);
});

test("WebAssembly counts the elements of lanes as plain TypeScript does", () => {
  const below = randomNumbers(5);
  for (let n = 0; n < 100; n++) {
    const seed = [below(2 ** 32), below(2 ** 32)] as const,
      first = below(2 ** 24),
      size = below(2000),
      lanes = 1 + below(n % 2 ? 64 : 2 ** 14);
    const counts = countLanes(first, size, seed, lanes);
    assert.equal(
      counts.reduce((sum, count) => sum + count, 0),
      size,
    );
    assert.deepEqual(countLanesFast(first, size, seed, lanes), counts);
  }
});

test("a decoder that grows keeps its instance while its tables stay", () => {
  const random = randomNumbers(3),
    first = anySideInfo(random),
    payload = Uint8Array.from({ length: 500 }, () => random(256)),
    packets = new FastPacketDecoder(first),
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
      const blockMeans = first.blockMeans.map((value) => value + group);
      packets.setInfo({ ...first, blockMeans, models: first.models.slice() });
      assertSame(
        packets.decode(payload, 0, 20),
        new PacketDecoder(packets.info).decode(payload, 0, 20),
        packets.info,
        0,
      );
    }
    assert.equal(made, 1);
    const other = anySideInfo(random);
    packets.setInfo(other);
    assertSame(packets.decode(payload, 0, 20), new PacketDecoder(other).decode(payload, 0, 20), other, 0);
    assert.equal(made, 2);
    for (const name of ["baseExponents", "scaleIndices", "models", "transform"] as const) {
      const before = packets.info;
      packets.setInfo({ ...before, [name]: before[name].map((value, n) => (n ? value : value ^ 1)) });
      packets.decode(payload, 0, 20);
      packets.setInfo(before);
      packets.decode(payload, 0, 20);
    }
    assert.equal(made, 2 + 8 - 2 * Number(!other.transform.length));
  } finally {
    WebAssembly.Instance = Instance;
  }
});

test("the 64-bit integers of WebAssembly are the numbers of its rows", () => {
  const random = randomNumbers(2),
    native = NativePacketDecoder.of(anySideInfo(random))!,
    payload = Uint8Array.from({ length: 3000 }, () => random(256));
  for (const count of [1, 2, 7, 300]) {
    const { rows } = native.decode(payload, 0, count),
      { integers } = native.decode(payload, 0, count, true),
      view = new DataView(integers!.buffer, integers!.byteOffset, integers!.byteLength);
    assert.equal(view.byteLength, rows.byteLength);
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
      native = NativePacketDecoder.of(info)!,
      plain = new PacketDecoder(info);
    for (let packet = 0; packet < 8; packet++) {
      const payload = Uint8Array.from({ length: random(400) }, () => random(256)),
        count = 1 + random(random(4) ? 40 : 300);
      assertSame(native.decode(payload, 0, count), plain.decode(payload, 0, count), info, 0);
    }
  }
});

/** Returns positions and steps of any tracks. Some positions are equal, so that neighbours are equally near. */
function anyKeyframes(headers: Int32Array, random: (below: number) => number): TrackKeyframes {
  const count = headers.length / HEADER_FIELDS,
    extent = 2 ** random(30),
    positions = Float64Array.from({ length: 3 * count }, () => random(3) && random(extent)),
    shifts = Int32Array.from({ length: NUM_CHANNELS * count }, () => random(31));
  return { positions, shifts };
}

/** Returns side information of motion; bytes decode to many tracks with long trajectories where `odds` is large. */
function anyMotionInfo(random: (below: number) => number, odds: number): SequenceInfo {
  const models = Int32Array.from({ length: 2 * NUM_CONTEXTS }, () => 256 * (1 + Math.floor(random(256) / odds)));
  return { models, keyframeInfo: { sizeLog: 1, latticeBits: 20 } } as unknown as SequenceInfo;
}

test("WebAssembly and plain TypeScript decode any bytes to the same motion", () => {
  const random = randomNumbers(4);
  let moved = 0;
  for (let trial = 0; trial < 40; trial++) {
    const info = anyMotionInfo(random, 1 + random(4)),
      native = NativeMotionPacketDecoder.of(info)!,
      plain = new PlainMotionPacketDecoder(info);
    for (let n = 0; n < 8; n++) {
      const payload = Uint8Array.from({ length: random(3000) }, () => random(256)),
        frames = 1 + random(n ? 16 : 64),
        packet: MotionPacket = { payload, count: 1 + random(200), frames, firstNew: random(2 ** 28) },
        seed = random(1000),
        keyframesOf = (headers: Int32Array) => anyKeyframes(headers, randomNumbers(seed)),
        expected = plain.decode(packet, keyframesOf)!,
        found = native.decode(packet, keyframesOf)!;
      assert.deepEqual(found, expected);
      for (let i = STATE; i < expected.headers.length; i += HEADER_FIELDS) moved += Number(expected.headers[i] === 1);
    }
  }
  assert.ok(moved > 5000, `${moved} tracks`);
});

test("motion whose offsets are too many for WebAssembly, or whose memory cannot grow, is decoded without it", () => {
  const random = randomNumbers(5),
    info = anyMotionInfo(random, 1),
    payload = Uint8Array.from({ length: 300 }, () => random(256)),
    keyframesOf = (headers: Int32Array) => anyKeyframes(headers, randomNumbers(6)),
    large = { payload, count: 6000, frames: 64, firstNew: 0 },
    small = { payload, count: 50, frames: 8, firstNew: 0 },
    plain = new PlainMotionPacketDecoder(info),
    { Instance } = WebAssembly;
  let made = 0;
  WebAssembly.Instance = class extends Instance {
    constructor(module: WebAssembly.Module, imports?: WebAssembly.Imports) {
      super(module, imports);
      made++;
      const { exports } = new Instance(module, imports);
      const readMotion = () => {
        throw new WebAssembly.RuntimeError("unreachable");
      };
      Object.defineProperty(this, "exports", { value: { ...exports, readMotion } });
    }
  };
  try {
    const packets = new FastMotionPacketDecoder(info);
    assert.deepEqual(packets.decode(large, keyframesOf), plain.decode(large, keyframesOf));
    assert.equal(made, 0);
    for (let n = 0; n < 2; n++) assert.deepEqual(packets.decode(small, keyframesOf), plain.decode(small, keyframesOf));
    assert.equal(made, 1);
  } finally {
    WebAssembly.Instance = Instance;
  }
});
