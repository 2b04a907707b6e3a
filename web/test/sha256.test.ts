// SHA-256 in TypeScript and in WebAssembly gives the published digests, and node's for any bytes in any pieces.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";

import { hex } from "../src/bytes.ts";
import { compressFast } from "../src/codec/gaussians/native.ts";
import { compress, newSha256, PortableSha256 } from "../src/sha256.ts";
import { random } from "./vectors.ts";

const next = random(3),
  BYTES = Uint8Array.from({ length: 200_000 }, () => Math.floor(256 * next()));
const expected = (bytes: Uint8Array): string => createHash("sha256").update(bytes).digest("hex");
/** Examples of FIPS 180 and of NIST. */
const PUBLISHED: [string, string][] = [
  ["", "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"],
  ["abc", "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"],
  [
    "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq",
    "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1",
  ],
  [
    "abcdefghbcdefghicdefghijdefghijkefghijklfghijklmghijklmnhijklmnoijklmnopjklmnopqklmnopqrlmnopqrsmnopqrstnopqrstu",
    "cf5b16a778af8380036ce59e7b0492370b249b11e8f07a51afac45037afee9d1",
  ],
  ["a".repeat(1_000_000), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0"],
];

for (const [name, blocks] of Object.entries({ TypeScript: compress, WebAssembly: compressFast })) {
  function digestOf(bytes: Uint8Array): string {
    const portable = new PortableSha256(blocks);
    portable.update(bytes);
    return hex(portable.digest());
  }

  test(`${name} gives the published digests`, () => {
    for (const [text, digest] of PUBLISHED) assert.equal(digestOf(new TextEncoder().encode(text)), digest);
  });

  test(`${name} gives node's digests for all lengths around blocks, at any address`, () => {
    for (const length of [...Array(200).keys(), 1000, 4999, 65_535, 65_536, 65_537, 131_136, 199_990]) {
      const at = Math.floor(10 * next()),
        bytes = BYTES.subarray(at, at + length);
      assert.equal(digestOf(bytes), expected(bytes), `${length} bytes`);
    }
  });

  test(`${name} gives the digest of the whole for any pieces`, () => {
    for (const most of [3, 64, 200, 5000, 100_000]) {
      const portable = new PortableSha256(blocks),
        native = newSha256(blocks),
        bytes = BYTES.subarray(0, 1000 * Math.min(most, 200));
      for (let at = 0; at < bytes.length; ) {
        const end = at + Math.floor(most * next());
        for (const hash of [portable, native]) hash.update(bytes.subarray(at, end));
        at = end;
      }
      assert.equal(hex(portable.digest()), expected(bytes));
      assert.equal(native.hex(), expected(bytes));
    }
  });
}

test("WebAssembly and TypeScript compute the same state from any state", () => {
  for (let n = 0; n < 50; n++) {
    const at = Math.floor(1000 * next()),
      blocks = BYTES.subarray(at, at + 64 * Math.floor(next() * (n % 10 ? 20 : 3000))),
      one = Int32Array.from({ length: 8 }, () => Math.floor(2 ** 32 * next())),
      other = one.slice();
    compress(one, blocks);
    compressFast(other, blocks);
    assert.deepEqual(other, one);
  }
});

test("two hashes at once do not disturb each other", () => {
  const one = new PortableSha256(compressFast),
    other = new PortableSha256(compressFast);
  for (let at = 0; at < 50_000; at += 1000) {
    one.update(BYTES.subarray(at, at + 1000));
    other.update(BYTES.subarray(at + 500, at + 1500));
  }
  assert.equal(hex(one.digest()), expected(BYTES.subarray(0, 50_000)));
  assert.equal(hex(other.digest()), expected(BYTES.subarray(500, 50_500)));
});
