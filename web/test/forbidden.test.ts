import assert from "node:assert/strict";
import { test } from "node:test";

import { compressFast, FastPacketDecoder, NativePacketDecoder } from "../src/codec/gaussians/native.ts";
import { PacketDecoder } from "../src/codec/gaussians/packet.ts";
import { compress } from "../src/sha256.ts";
import { anySideInfo, randomNumbers } from "./side_info.ts";

test("a page that forbids WebAssembly decodes to the same integers, and hashes", () => {
  class Forbidden {
    constructor() {
      throw new WebAssembly.CompileError("Wasm code generation disallowed by embedder");
    }
  }
  Object.assign(WebAssembly, { Module: Forbidden });
  const random = randomNumbers(2),
    info = anySideInfo(random),
    payload = Uint8Array.from({ length: 300 }, () => random(256));
  assert.equal(NativePacketDecoder.of(info), null);
  assert.deepEqual(new FastPacketDecoder(info).decode(payload, 0, 40), new PacketDecoder(info).decode(payload, 0, 40));
  const states = [compressFast, compress].map((update) => {
    const state = Int32Array.from({ length: 8 }, (_, n) => n);
    update(state, payload.subarray(0, 256));
    return state;
  });
  assert.deepEqual(states[0], states[1]);
});
