// Requests for gains while packets arrive, and their answers by the worker.

import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { ContainerReader } from "../src/packets/container.ts";
import { Plan } from "../src/packets/plan.ts";
import { splitmix, splitmixModulo } from "../src/packets/splitmix64.ts";
import { GainsRequests } from "../src/page/gains_requests.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { WorkerReceiver } from "../src/worker_receiver.ts";
import { fileOf, readStream } from "./vectors.ts";

const STILL = "../tests/golden/tiny_causal.swz";
const simulation = { concealer: "grow", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };

test("requests for arriving packets wait longer for answers each time, so that a slow worker can give one", () => {
  let now = 0;
  const times: number[] = [],
    gains: GainsRequests = new GainsRequests(() => {
      gains.next();
      times.push(now);
    });
  mock.timers.enable({ apis: ["setTimeout"] });
  mock.method(performance, "now", () => now);
  const arrive = (seconds: number): void => {
    for (const end = now + 1000 * seconds; now < end; now += 100, mock.timers.tick(100)) gains.soon();
  };
  arrive(90);
  assert.ok(!gains.settled);
  assert.deepEqual(times, [1000, 2000, 6000, 22_000, 42_000, 62_000, 82_000]);
  assert.equal(gains.onAnswer(times.length - 1), false);
  assert.equal(gains.onAnswer(times.length), true);
  assert.ok(gains.settled);
  gains.next();
  now += 10;
  gains.onAnswer(times.length + 1); // a fast answer ends the long intervals, once the timer that runs has ended
  arrive(400);
  assert.ok(times.length > 20);
  gains.skip();
  assert.ok(gains.settled);
  mock.restoreAll();
  mock.timers.reset();
});

test("gains are requested again after a time without a scene that has them", () => {
  let requests = 0;
  mock.timers.enable({ apis: ["setTimeout"] });
  const gains = new GainsRequests(() => requests++); // a clip makes no request of it
  for (let n = 1; n < 4; n++) {
    gains.soon();
    mock.timers.tick(20_000);
    assert.equal(requests, n);
  }
  mock.timers.reset();
});

test("gains are computed once all received packets are decoded, and only for the last request", async () => {
  const said: FromWorker[] = [],
    container = new ContainerReader(),
    packets = container.feed(fileOf(STILL)).map((bytes, position) => ({ order: "session", position, bytes }));
  Object.assign(globalThis, { self: { postMessage: (message: FromWorker) => said.push(message) } });
  const reception = new WorkerReceiver();
  reception.head(container.head!, container.headBytes, false);
  reception.packets(packets.slice(1));
  await Promise.all([1, 2].map((requestId) => reception.conceal({ kind: "conceal", simulation, requestId })));
  await reception.settled();
  const found = said.flatMap((one) => (one.kind === "gains" ? [[one.requestId, one.numKept]] : []));
  assert.deepEqual(found, [[2, packets.length - 1]]);
});

test("properties of the elements are only computed if something is missing", async () => {
  const { head, packets } = readStream(STILL),
    received = new DecodedStream(head),
    elements = mock.method(received.decoder.elementDecoder, "elements"),
    calls: number[] = [];
  for (const some of [packets.slice(1), packets.slice(0, 1)]) {
    for (const bytes of some) received.addPacket(bytes);
    assert.equal(
      await received.conceal(simulation, async () => true),
      calls.length ? packets.length : packets.length - 1,
    );
    calls.push(elements.mock.callCount());
  }
  assert.deepEqual(calls, [1, 1]);
  assert.ok(received.gains!.every((gain) => gain === 1));
});

for (const grouping of ["stratified", "contiguous", "hashed"])
  test(`members of ${grouping} packets equal those of a search, and a block is searched once`, () => {
    const { manifest } = readStream(STILL).head,
      seed = [0x89abcdef, 0x01234567] as const,
      packetization = { ...manifest.packetization, grouping, seed, blockSize: 300, lanes: 5 },
      plan = new Plan({ ...manifest, count: 700, tiers: [], packetization });
    for (const [block, start] of [0, 300, 600].entries()) {
      const size = plan.numElementsOf(block),
        places = Array.from({ length: size }, (_, n) => start + n),
        hash = (place: number): bigint => {
          const [low, high] = splitmix((place ^ seed[0]) >>> 0, seed[1]);
          return (BigInt(high) << 32n) | BigInt(low);
        },
        laneOf = (place: number): number => splitmixModulo((place ^ seed[0]) >>> 0, seed[1], 5),
        order = plan.elementsOf(block);
      if (grouping === "stratified") places.sort((a, b) => laneOf(a) - laneOf(b) || a - b);
      if (grouping === "hashed") places.sort((a, b) => (hash(a) < hash(b) ? -1 : 1));
      assert.deepEqual([...order], places);
      for (let index = 0, first = 0; index < 5; index++) {
        const count = grouping === "hashed" ? 20 : plan.capacity(block, index),
          from = grouping === "hashed" ? index : first,
          members = plan.members({ block, indexInBlock: index, count });
        assert.deepEqual([...members], places.slice(from, from + count));
        assert.equal(members.buffer, order.buffer);
        first += count;
      }
    }
  });
