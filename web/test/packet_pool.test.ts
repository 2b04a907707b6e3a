import assert from "node:assert/strict";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import { type FromHelper, PacketHelper, type ToHelper } from "../src/packet_helper.ts";
import { type HelperThread, numHelpers, PacketPool } from "../src/packet_pool.ts";
import type { Head } from "../src/packets/container.ts";
import { readPacket } from "../src/packets/packet.ts";
import { pack } from "../src/render/packed.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { fileOf, readStream, STREAMS } from "./vectors.ts";

const ALL_KEPT = { keptBytes: 1 << 30 };

/** Thread of the test: structured clones with transfers, as between workers, delivered in later tasks. */
class FakeThread implements HelperThread {
  onmessage: HelperThread["onmessage"] = null;
  onerror: HelperThread["onerror"] = null;
  ended = false;
  readonly #helper = new PacketHelper((message, hand) => this.answer(structuredClone(message, { transfer: hand })));

  /** `lateMs` delays each answer. */
  constructor(readonly lateMs = 0) {}

  postMessage(message: ToHelper, hand: ArrayBuffer[]): void {
    const cloned = structuredClone(message, { transfer: hand });
    setTimeout(() => this.ended || this.handle(cloned), this.lateMs);
  }

  terminate(): void {
    this.ended = true;
  }

  protected handle(message: ToHelper): void {
    this.#helper.receive(message);
  }

  protected answer(data: FromHelper): void {
    if (!this.ended) this.onmessage?.({ data } as MessageEvent<FromHelper>);
  }

  fail(): void {
    this.onerror?.({} as ErrorEvent);
  }
}

/** Thread whose decoder fails, as for lack of memory. */
class FailingThread extends FakeThread {
  protected override handle(message: ToHelper): void {
    if (message.kind === "help") return super.handle(message);
    this.answer({ kind: "decoded", number: message.number, packets: null, ms: 1 });
  }
}

interface Gaussians {
  readonly file: Uint8Array;
  readonly head: Head;
  readonly packets: Uint8Array[];
}

function streamsOf(codec: string): Gaussians[] {
  return STREAMS.map((path) => ({ ...readStream(path), bytes: fileOf(path) }))
    .filter(({ head }) => head.manifest.codec === codec)
    .map(({ head, packets, bytes }) => {
      const packetBytes = packets.reduce((sum, packet) => sum + 4 + packet.length, 0);
      return { head, packets, file: bytes.slice(0, bytes.length - packetBytes) };
    });
}

async function ready(pool: PacketPool): Promise<void> {
  while (!pool.capacity) await new Promise((resolve) => setTimeout(resolve, 1));
}

/** Decodes packets in a pool, a batch after another, and adds them in order. */
async function decoded(pool: PacketPool, { head, packets }: Gaussians): Promise<DecodedStream> {
  const received = new DecodedStream(head, ALL_KEPT),
    batches = [];
  for (let n = 0; n < packets.length; n += 3) {
    const some = packets.slice(n, n + 3).map((bytes) => received.decoder.admit(bytes)!);
    batches.push({ some, batch: pool.decode(some) });
  }
  for (const { some, batch } of batches) {
    const found = await batch;
    for (const [n, packet] of some.entries()) received.accept(packet, found?.packets[n] ?? null);
  }
  return received;
}

async function splatsOf(received: DecodedStream): Promise<unknown> {
  const camera = { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };
  return (await received.gaussiansFor(camera, true, async () => true))!.parts;
}

function alone({ head, packets }: Gaussians): DecodedStream {
  const received = new DecodedStream(head);
  for (const bytes of packets) received.addPacket(bytes);
  return received;
}

for (const [n, stream] of streamsOf("gaussians").entries()) {
  test(`helpers decode stream ${n} to the Gaussians, the order and the digest of one thread`, async () => {
    const late = [7, 0, 3],
      pool = new PacketPool(stream.file, () => new FakeThread(late.pop()), 3);
    await ready(pool);
    const received = await decoded(pool, stream);
    assert.deepEqual(await splatsOf(received), await splatsOf(alone(stream)));
    assert.equal(await received.decoder.digest(), stream.head.manifest.symbolsDigest);
    pool.close();
  });

  test(`packets of stream ${n} are decoded here if helpers fail or end`, async () => {
    const threads = [new FailingThread(), new FakeThread(5)],
      unused = [...threads],
      pool = new PacketPool(stream.file, () => unused.shift()!, 2);
    await ready(pool);
    const all = decoded(pool, stream);
    threads[1].fail();
    assert.deepEqual(await splatsOf(await all), await splatsOf(alone(stream)));
    assert.ok(threads[1].ended);
    pool.close();
    assert.ok(threads[0].ended);
  });

  test(`the integers of stream ${n} are not decoded again for its digest in any order of packets`, async () => {
    const received = new DecodedStream(stream.head, ALL_KEPT),
      { elementDecoder } = received.decoder;
    for (const bytes of [...stream.packets].reverse()) received.addPacket(bytes);
    elementDecoder.decode = () => assert.fail("decoded again");
    const blocks = Array.from({ length: received.decoder.intake.plan.numBlocks }, (_, block) =>
        received.decoder.intake.blocks.get(block)!.map((packet) => ({ ...packet, payload: new Uint8Array() })),
      ),
      digest = await elementDecoder.digest(blocks, async () => true);
    assert.equal(digest, stream.head.manifest.symbolsDigest);
  });

  test(`the integers of stream ${n} are not decoded again if a few packets precede those before them`, async () => {
    const sizes = stream.packets.map((bytes) => {
        const { symbols } = new DecodedStream(stream.head).decoder.elementDecoder.decode!(
          readPacket(bytes, stream.head.manifest.streamId)!,
        )!;
        return symbols.harmonics.byteLength + symbols.integers!.length;
      }),
      received = new DecodedStream(stream.head, { keptBytes: 3 * Math.max(...sizes) });
    for (let n = 0; n < stream.packets.length; n += 3)
      for (const bytes of stream.packets.slice(n, n + 3).reverse()) received.addPacket(bytes);
    const { elementDecoder, intake } = received.decoder,
      blocks = Array.from({ length: intake.plan.numBlocks }, (_, block) =>
        intake.blocks.get(block)!.map((packet) => ({ ...packet, payload: new Uint8Array() })),
      );
    assert.equal(await elementDecoder.digest(blocks, async () => true), stream.head.manifest.symbolsDigest);
  });

  test(`helpers pack the Gaussians of stream ${n} as the receiver's worker does`, async () => {
    const pool = new PacketPool(stream.file, () => new FakeThread(), 1),
      { decoder } = new DecodedStream(stream.head),
      { degree, size } = decoder.elementDecoder;
    await ready(pool);
    const batch = await pool.decode(stream.packets.slice(0, 3).map((bytes) => decoder.admit(bytes)!));
    for (const packet of batch!.packets) assert.deepEqual(packet!.packed, pack([packet!.splats], degree, size));
    pool.close();
  });

  test(`integers of stream ${n} beyond the memory for them are decoded again`, async () => {
    const received = new DecodedStream(stream.head, { keptBytes: 1 });
    for (const bytes of [...stream.packets].reverse()) received.addPacket(bytes);
    assert.equal(await received.decoder.digest(), stream.head.manifest.symbolsDigest);
  });
}

for (const stream of streamsOf("tracks")) {
  test("helpers decode the keyframe Gaussians of a clip, whose frames are those of one thread", async () => {
    const pool = new PacketPool(stream.file, () => new FakeThread(), 2);
    await ready(pool);
    const [shared, own] = [await decoded(pool, stream), alone(stream)].map(
      ({ decoder }) => decoder.elementDecoder.sequence!,
    );
    for (let n = 0; n < own.timeline.numFrames; n++)
      assert.deepEqual(shared.frame(n, () => true, "drop").splats, own.frame(n, () => true, "drop").splats);
    pool.close();
  });
}

test("the number of helpers depends on cores, memory and the size of the scene", () => {
  assert.equal(numHelpers(150_000, { hardwareConcurrency: 3 }), 2);
  assert.equal(numHelpers(150_000, { hardwareConcurrency: 64 }), 4);
  assert.equal(numHelpers(150_000, { hardwareConcurrency: 8, deviceMemory: 2 }), 2);
  for (const device of [
    {},
    { hardwareConcurrency: 1 },
    { hardwareConcurrency: 2 },
    { hardwareConcurrency: 8, deviceMemory: 0.5 },
  ])
    assert.equal(numHelpers(150_000, device), 0);
  assert.equal(numHelpers(5_000, { hardwareConcurrency: 8 }), 0);
});

for (const { file, head, packets } of streamsOf("gaussians").slice(0, 1)) {
  test("a pool without threads has no room, and its batches are decoded by its owner", async () => {
    const pool = new PacketPool(
      file,
      () => {
        throw new Error("Refused to create a worker because it violates the policy");
      },
      4,
    );
    assert.equal(pool.capacity, 0);
    assert.equal(await pool.decode([readPacket(packets[0], head.manifest.streamId)!]), null);
  });

  test("an error of the decoder in a helper is reported by the owner's decoder", async () => {
    const pool = new PacketPool(file, () => new FailingThread(), 1),
      received = new DecodedStream(head),
      packet = received.decoder.admit(packets[0])!;
    await ready(pool);
    received.decoder.elementDecoder.read = () => {
      throw new BitstreamError("damaged");
    };
    const batch = await pool.decode([packet]);
    assert.throws(() => received.accept(packet, batch?.packets[0] ?? null), /damaged/);
    pool.close();
  });

  test("batches that are under way when a pool is closed resolve to null", async () => {
    const pool = new PacketPool(file, () => new FakeThread(), 2);
    await ready(pool);
    const batch = pool.decode([readPacket(packets[0], head.manifest.streamId)!]);
    pool.close();
    assert.equal(await batch, null);
    assert.equal(pool.capacity, 0);
  });

  test("batches are small if few packets are waiting", async () => {
    const pool = new PacketPool(file, () => new FakeThread(), 2);
    while (pool.capacity < 4) await new Promise((resolve) => setTimeout(resolve, 1));
    assert.deepEqual(
      [1, 4, 12, 400].map((waiting) => pool.batchSize(waiting)),
      [1, 1, 3, 8],
    );
    pool.close();
  });
}
