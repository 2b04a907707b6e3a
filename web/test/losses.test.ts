import assert from "node:assert/strict";
import { test } from "node:test";

import { keptPackets, type LossSimulation } from "../src/transport/losses.ts";

const PACKETS = Array.from({ length: 20_000 }, (_, n) => ({ block: n >> 4, indexInBlock: n & 15 }));
const choose = (some: Partial<LossSimulation>): LossSimulation => ({
  concealer: "drop",
  lossRate: 0.2,
  burstLength: 1,
  seed: 0,
  sentShare: 1,
  ...some,
});
const lost = (some: Partial<LossSimulation>): boolean[] => keptPackets(PACKETS, choose(some)).map((kept) => !kept);
const share = (lost: boolean[]): number => lost.filter(Boolean).length / lost.length;

test("the lost share equals the chosen one, with and without bursts", () => {
  for (const lossRate of [0, 0.2, 0.5, 0.95]) {
    for (const burstLength of [1, 8])
      assert.ok(Math.abs(share(lost({ lossRate, burstLength })) - lossRate) < 0.05, `${lossRate} ${burstLength}`);
  }
});

test("the mean burst length equals the chosen one", () => {
  for (const burstLength of [1, 8]) {
    const found = lost({ burstLength }),
      bursts = found.filter((is, n) => is && !found[n - 1]).length,
      mean = found.filter(Boolean).length / bursts;
    assert.ok(Math.abs(mean / (burstLength === 1 ? 1.25 : burstLength) - 1) < 0.15, `${mean}`);
  }
});

test("a larger share is a superset, another seed differs, and unsent packets are lost", () => {
  const few = lost({ lossRate: 0.1 }),
    many = lost({ lossRate: 0.3 });
  assert.ok(few.every((is, n) => !is || many[n]));
  assert.notDeepEqual(many, lost({ lossRate: 0.3, seed: 1 }));
  const half = lost({ lossRate: 0, sentShare: 0.5 });
  assert.deepEqual(
    half,
    PACKETS.map((_, n) => n >= PACKETS.length / 2),
  );
  // later packets do not change the losses of earlier ones
  assert.deepEqual(
    keptPackets(PACKETS.slice(0, 99), choose({ burstLength: 8 })),
    keptPackets(PACKETS, choose({ burstLength: 8 })).slice(0, 99),
  );
});
