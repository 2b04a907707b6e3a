// The portable SHA-256 gives node's digests for all lengths around blocks, in any pieces.

import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { test } from "node:test";

import { hex } from "../src/bytes.ts";
import { newSha256, PortableSha256 } from "../src/sha256.ts";
import { random } from "./vectors.ts";

const next = random(3),
  BYTES = Uint8Array.from({ length: 5000 }, () => Math.floor(256 * next()));
const expected = (bytes: Uint8Array): string => createHash("sha256").update(bytes).digest("hex");

function digestOf(bytes: Uint8Array): string {
  const portable = new PortableSha256();
  portable.update(bytes);
  return hex(portable.digest());
}

test("digests are those of node", () => {
  for (const length of [...Array(200).keys(), 1000, 4999])
    assert.equal(digestOf(BYTES.subarray(0, length)), expected(BYTES.subarray(0, length)));
});

test("pieces give the digest of the whole", () => {
  const portable = new PortableSha256(),
    native = newSha256();
  for (let at = 0; at < BYTES.length; ) {
    const end = at + Math.floor(200 * next());
    for (const hash of [portable, native]) hash.update(BYTES.subarray(at, end));
    at = end;
  }
  assert.equal(hex(portable.digest()), expected(BYTES));
  assert.equal(native.hex(), expected(BYTES));
});
