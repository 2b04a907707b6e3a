// Digest of decoded integers in hostile orders of packets.

import assert from "node:assert/strict";
import { test } from "node:test";

import { SymbolsDigest } from "../src/codec/gaussians/digest.ts";
import type { Decoded } from "../src/codec/gaussians/packet.ts";
import type { Packet } from "../src/packets/packet.ts";

const COUNT = 20_000;

test("packets in the reverse order are compared with few others, and give the digest of the plan", async () => {
  let comparisons = 0;
  const packets = Array.from({ length: COUNT }, (_, indexInBlock) => ({
    indexInBlock,
    get block() {
      comparisons++;
      return 0;
    },
  })) as unknown as Packet[];
  const decoded = ({ indexInBlock }: Packet): Decoded =>
    ({ rows: Float64Array.of(indexInBlock), harmonics: new Int32Array() }) as unknown as Decoded;
  const digestOf = (order: readonly Packet[]): Promise<string> => {
    const digest = new SymbolsDigest(32 << 20);
    for (const packet of order) digest.add(packet, decoded(packet));
    return digest.finish([packets], async () => true, decoded);
  };
  const expected = await digestOf(packets);
  comparisons = 0;
  assert.equal(await digestOf([...packets].reverse()), expected);
  assert.ok(comparisons < COUNT ** 2 / 8, `${comparisons} comparisons`);
});
