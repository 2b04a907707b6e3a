import assert from "node:assert/strict";
import { test } from "node:test";
import { StreamDecoder } from "../src/codec/decoder.ts";
import { attack, attackCopies } from "./hostile.ts";
import { readStream, STREAMS } from "./vectors.ts";

const CASES = Number(process.env["CASES"] ?? 300);

for (const path of STREAMS) {
  test(`${CASES} hostile cases against ${path.split("/").pop()}`, () => {
    const { head, packets } = readStream(path);
    assert.ok(attack(head, packets, CASES, 5) > CASES / 4, "too few of them reached the decoder");
  });

  const { head } = readStream(path);
  if (!new StreamDecoder(head).elementDecoder.sections.has("sketch")) continue;
  test(`${CASES} hostile sections of redundant copies of ${path.split("/").pop()}`, async () => {
    assert.ok((await attackCopies(head, CASES, 6)) > CASES / 10, "too few of them were read");
  });
}
