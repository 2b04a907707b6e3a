// Packets of a live clip that wait for decoding: a device that is too slow drops whole groups of frames.

import assert from "node:assert/strict";
import { test } from "node:test";

import { ContainerReader } from "../src/packets/container.ts";
import { planOf } from "../src/packets/plan.ts";
import { type ReceivedPacket, UNKNOWN_ORDER } from "../src/transport/events.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { packetOf } from "../src/transport/packet_store.ts";
import { WorkerReceiver } from "../src/worker_receiver.ts";
import { otherStream } from "./fake_web.ts";
import { fileOf } from "./vectors.ts";

/** Number of packets that may wait. */
const MAX_WAITING = 65_536;
const CLIP = fileOf("../tests/golden/tiny_clip.swz");

/** Returns the beginning of a clip and the packets of each of its groups. */
function groupsOf(file: Uint8Array): { container: ContainerReader; groups: ReceivedPacket[][] } {
  const container = new ContainerReader(),
    groups: ReceivedPacket[][] = [];
  for (const bytes of container.feed(file)) {
    const group = planOf(container.head!.manifest).gopOf(packetOf(bytes, container.head!)!.block);
    (groups[group] ??= []).push({ order: UNKNOWN_ORDER, position: 0, bytes });
  }
  return { container, groups };
}

test("a full queue drops whole groups of frames of a live clip, until its next period", async () => {
  const said: FromWorker[] = [];
  (globalThis as Record<string, unknown>)["self"] = { postMessage: (message: FromWorker) => said.push(message) };
  const reception = new WorkerReceiver(),
    last = <Kind extends FromWorker["kind"]>(kind: Kind): (FromWorker & { kind: Kind }) | undefined =>
      said.filter((one): one is FromWorker & { kind: Kind } => one.kind === kind).at(-1);
  const counts = { transport: "", bytes: 0, packets: 0, expected: 0, lost: 0, rejected: 0, seconds: 0 };
  for (const [file, isSlow] of [
    [CLIP, true],
    [otherStream(CLIP), false],
  ] as const) {
    const { container, groups } = groupsOf(file);
    assert.ok(groups.length > 1);
    reception.head(container.head!, container.headBytes, false, true);
    reception.packets(groups[0]);
    // copies of a packet wait, too, until decoding finds out
    if (isSlow) reception.packets(Array.from({ length: MAX_WAITING - groups[0].length }, () => groups[0][0]));
    reception.packets(groups[1].slice(0, 1));
    await reception.settled();
    reception.packets(groups[1]); // there is room again, but the group would have losses
    reception.counts(counts);
    await reception.settled();
    assert.equal(last("counts")!.droppedGroups, isSlow ? 1 : 0);
    assert.equal(last("playable")!.end, isSlow ? 4 : 8);
  }
});
