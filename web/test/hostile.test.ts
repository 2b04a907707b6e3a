import assert from "node:assert/strict";
import { test } from "node:test";

import { attack } from "./hostile.ts";
import { readStream, STREAMS } from "./vectors.ts";

const CASES = Number(process.env["CASES"] ?? 300);

for (const path of STREAMS) {
  test(`${CASES} hostile cases against ${path.split("/").pop()}`, () => {
    const { head, packets } = readStream(path);
    assert.ok(attack(head, packets, CASES, 5) > CASES / 4, "too few of them reached the decoder");
  });
}
