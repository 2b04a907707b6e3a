// Small streams that announce, or claim to hold, as much as their format lets them (tests/greedy.py): what each takes.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { pack } from "../src/render/packed.ts";
import { Received } from "../src/transport/received.ts";
import { CAMERA } from "./hostile.ts";

const MOST_MB = 400;
const PATHS = (process.env["GREEDY"] ?? "").split(":").filter(Boolean);
const pause = async (): Promise<boolean> => true;
const peak = (): number => process.resourceUsage().maxRSS / 1024;

async function shown(path: string): Promise<void> {
  const container = new ContainerReader(),
    packets = container.feed(readFileSync(path)),
    received = new Received(container.head!),
    { schema } = received.decoder,
    choice = { concealer: "grow", dropped: 0, burst: 1, seed: 0, sent: 1 };
  for (const packet of packets) received.take(packet);
  if (schema.moving) {
    for (const concealer of schema.moving.concealers) schema.moving.frame(0, () => true, concealer);
    schema.moving.ahead(0, 1000);
    return;
  }
  const seen = await received.seen(CAMERA, true, pause);
  pack(seen!.parts, schema.degree, schema.size);
  await received.prepare(choice, pause);
  await received.conceal(choice, pause);
}

test(`${PATHS.length} greedy streams take little memory`, { skip: !PATHS.length }, async () => {
  const before = peak(),
    found: string[] = [];
  let refused = 0;
  for (const path of PATHS) {
    const name = path.split("/").pop();
    try {
      await shown(path);
    } catch (error) {
      assert.ok(error instanceof BitstreamError, `${name}: ${(error as Error).stack}`);
      refused += 1;
    }
    console.log(name, Math.round(peak() - before), "MB");
    if (peak() - before > MOST_MB) found.push(`${name}: ${Math.round(peak() - before)} MB`);
  }
  assert.deepEqual(found, []);
  assert.ok(refused > 3, "too few were refused");
});
