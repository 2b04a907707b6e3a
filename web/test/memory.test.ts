// Memory of small streams that announce as many elements as the format permits (tests/oversized.py).

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";

import { BitstreamError } from "../src/bytes.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { pack } from "../src/render/packed.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { CAMERA } from "./hostile.ts";

const MAX_MB = 400;
const PATHS = (process.env["GREEDY"] ?? "").split(":").filter(Boolean);
const pause = async (): Promise<boolean> => true;
const peak = (): number => process.resourceUsage().maxRSS / 1024;

async function shown(path: string): Promise<void> {
  const container = new ContainerReader(),
    packets = container.feed(readFileSync(path)),
    received = new DecodedStream(container.head!),
    { elementDecoder } = received.decoder,
    simulation = { concealer: "grow", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };
  for (const packet of packets) received.addPacket(packet);
  if (elementDecoder.sequence) {
    for (const concealer of elementDecoder.sequence.concealers) elementDecoder.sequence.frame(0, () => true, concealer);
    elementDecoder.sequence.prefetch(0, 1000);
    return;
  }
  const seen = await received.gaussiansFor(CAMERA, true, pause);
  pack(seen!.parts, elementDecoder.degree, elementDecoder.size);
  await received.prepare(simulation, pause);
  await received.conceal(simulation, pause);
}

/** Prints the memory in MB that one stream took in this process, and "refused" where the decoder refused it. */
async function measure(path: string): Promise<void> {
  const before = peak();
  let refused = "";
  try {
    await shown(path);
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
    refused = "refused";
  }
  console.log(`taken ${Math.round(peak() - before)} ${refused}`);
}

// Each stream has a process of its own: the peak of one process counts what earlier streams left for the collector.
const ALONE = process.env["ALONE"];
if (ALONE) await measure(ALONE);
else
  test(`${PATHS.length} amplification streams need little memory`, { skip: !PATHS.length }, () => {
    const found: string[] = [];
    let refused = 0;
    for (const path of PATHS) {
      const name = path.split("/").pop(),
        env = { ...process.env, ALONE: path, NODE_TEST_CONTEXT: undefined },
        done = spawnSync(process.execPath, [fileURLToPath(import.meta.url)], { env, encoding: "utf8" }),
        [, taken, outcome] = /taken (\d+) (.*)/.exec(done.stdout) ?? assert.fail(`${name}: ${done.stderr}`);
      console.log(name, taken, "MB", outcome);
      if (Number(taken) > MAX_MB) found.push(`${name}: ${taken} MB`);
      if (outcome === "refused") refused += 1;
    }
    assert.deepEqual(found, []);
    assert.ok(refused > 3, "too few were refused");
  });
