import assert from "node:assert/strict";
import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { test } from "node:test";

import { ContainerReader, type Head, HeadReader } from "../src/packets/container.ts";
import { withBackoff } from "../src/transport/backoff.ts";
import { type Counts, FILE_ORDER, type Listener, type ReceivedPacket } from "../src/transport/events.ts";
import { HttpError } from "../src/transport/http_error.ts";
import { HttpFile } from "../src/transport/http_file.ts";
import { receiveFile } from "../src/transport/http_source.ts";
import { HEAD, partOf, recordsOf } from "../src/transport/packet_cache.ts";
import { PacketStore, SIZE_BYTES } from "../src/transport/packet_store.ts";
import { flipped, otherStream, packetOffsets } from "./fake_web.ts";
import { fileOf, STREAMS } from "./vectors.ts";

const STREAM = fileOf("../tests/golden/tiny_causal.swz");

/** Packets of a file with their positions in an order. */
function arrived(file: Uint8Array, order: string, positions: (n: number, offset: number) => number): ReceivedPacket[] {
  const offsets = packetOffsets(file);
  return new ContainerReader()
    .feed(file)
    .map((bytes, n) => ({ order, position: positions(n, offsets[n] - SIZE_BYTES), bytes }));
}

function begun(file: Uint8Array): PacketStore {
  const store = new PacketStore(),
    reader = new HeadReader();
  reader.feed(file);
  store.begin(reader.headBytes, reader.head!);
  return store;
}

test("gaps of a file lie between the packets that were found in it", () => {
  const store = begun(STREAM),
    packets = arrived(STREAM, FILE_ORDER, (_, offset) => offset),
    [first, , third, fourth] = packets.map(({ position }) => position);
  assert.deepEqual(new PacketStore().gaps, []);
  assert.deepEqual(store.gaps, [{ offset: first, end: null, before: null }]);
  assert.equal(store.add(packets.slice(1, 3)).length, 2);
  assert.deepEqual(store.gaps, [
    { offset: first, end: packets[1].position, before: null },
    { offset: fourth, end: null, before: third },
  ]);
  assert.equal(store.add(packets.slice(0, 2)).length, 1);
  assert.deepEqual(store.gaps, [{ offset: fourth, end: null, before: third }]);
  store.add(packets);
  assert.deepEqual([store.gaps, store.complete, store.isReordered], [[], true, false]);
});

test("packets are held once, whatever their order", () => {
  const store = begun(STREAM),
    inFile = arrived(STREAM, FILE_ORDER, (_, offset) => offset),
    { length } = inFile;
  const inSession = arrived(STREAM, "order", (n) => length - 1 - n);
  store.add(inSession.slice(0, 3));
  assert.deepEqual(store.bitsOf("other order"), null);
  const bits = store.bitsOf("order")!;
  const positions = Array.from({ length }, (_, n) => n).filter((n) => (bits[n >> 3] >> (n & 7)) & 1);
  assert.deepEqual(positions, [length - 3, length - 2, length - 1]);
  assert.equal(store.add(inFile).length, length - 3);
  assert.deepEqual([store.count, store.complete], [length, true]);
});

test("an order that names a packet twice claims nothing", () => {
  const store = begun(STREAM),
    [packet] = arrived(STREAM, "order", (n) => n);
  store.add([packet, { ...packet, position: 2 }]);
  assert.equal(store.bitsOf("order"), null);
});

test("damaged packets and those of another stream are not held", () => {
  const store = begun(STREAM),
    [packet] = arrived(STREAM, FILE_ORDER, (_, offset) => offset);
  const damaged = { ...packet, bytes: flipped(packet.bytes, 20) },
    [foreign] = arrived(otherStream(STREAM), FILE_ORDER, (_, offset) => offset);
  assert.deepEqual(store.add([damaged, foreign]), []);
  assert.equal(store.count, 0);
});

test("what is kept is read again, as far as it is whole", () => {
  const packets = [
      { order: FILE_ORDER, position: 7 * 2 ** 32, bytes: new Uint8Array(20).fill(7) },
      { order: "0badcafe", position: 3, bytes: new Uint8Array() },
      { order: HEAD, position: 0, bytes: new Uint8Array(5).fill(1) },
    ],
    bytes = partOf(packets);
  assert.deepEqual(recordsOf(bytes), packets);
  assert.deepEqual(recordsOf(bytes.subarray(0, bytes.length - 1)), packets.slice(0, 2));
});

test("failed attempts are retried with exponential backoff until the error is final", async () => {
  const waits: number[] = [],
    reasons: string[] = [],
    results = ["a", "b", "c", "got some", "d", null];
  let arrived = 0;
  const attempt = async (): Promise<string> => {
    const result = results.shift();
    if (result === "got some") arrived++;
    if (result) throw new Error(result);
    return "complete";
  };
  const how = {
    isRetryable: (error: unknown) => (error as Error).message !== "d",
    progress: () => arrived,
    disconnected: (reason: string) => void reasons.push(reason),
    wait: async (ms: number) => void waits.push(ms),
  };
  await assert.rejects(withBackoff(attempt, how), /d/);
  assert.deepEqual(reasons, ["a", "b", "c", "got some"]);
  assert.deepEqual(waits, [500, 1000, 2000, 500]);
  assert.equal(await withBackoff(attempt, how), "complete");
});

class Notes implements Listener {
  head_: Head | null = null;
  seen: Counts | null = null;

  constructor(readonly store: PacketStore) {}

  preview(): void {}

  head(head: Head, fileHead: Uint8Array): void {
    this.head_ = head;
    if (!this.store.hasHead) this.store.begin(fileHead, head);
  }

  packets(packets: readonly ReceivedPacket[]): void {
    this.store.add(packets);
  }

  counts(counts: Counts): void {
    this.seen = counts;
  }

  stopped(): boolean {
    return false;
  }
}

type Answer = (request: IncomingMessage, response: ServerResponse) => void;

/** Runs `work` with a server that gives the answers in turn. Returns the requested ranges. */
async function served(answers: Answer[], work: (url: string) => Promise<void>): Promise<(string | undefined)[]> {
  const ranges: (string | undefined)[] = [];
  const server = createServer((request, response) => {
    ranges.push(request.headers.range);
    answers.shift()!(request, response);
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  try {
    await work(`http://127.0.0.1:${(server.address() as AddressInfo).port}/streams/scene.swz`);
  } finally {
    server.closeAllConnections();
    server.close();
  }
  return ranges;
}

for (const path of STREAMS.slice(0, 1)) {
  const file = fileOf(path);
  const whole: Answer = (_, response) => void response.end(file);
  const bounds = (request: IncomingMessage): [number, number] => {
    const [, from, to] = /bytes=(\d+)-(\d*)/.exec(request.headers.range!)!;
    return [Number(from), Math.min(to ? Number(to) + 1 : Infinity, file.length)];
  };
  const part: Answer = (request, response) => {
    const [from, end] = bounds(request);
    response.writeHead(206, { "Content-Range": `bytes ${from}-${end - 1}/${file.length}` });
    response.end(file.subarray(from, end));
  };
  const cut: Answer = (request, response) => {
    const [from, end] = bounds(request);
    response.writeHead(206, { "Content-Length": end - from });
    response.write(file.subarray(from, from + Math.floor(0.7 * (end - from))), () => response.destroy());
  };

  test("an interrupted file is requested from the interruption on", async () => {
    const store = new PacketStore(),
      notes = new Notes(store);
    let firstMissing = 0;
    const ranges = await served([cut, part], async (url) => {
      const visit = new HttpFile(url);
      await assert.rejects(receiveFile(visit, notes, store));
      assert.ok(store.count > 0 && store.count < notes.head_!.manifest.numPackets);
      firstMissing = store.gaps[0].before!;
      assert.equal(await receiveFile(visit, notes, store), "complete");
      assert.equal(store.count, notes.head_!.manifest.numPackets);
    });
    assert.match(ranges[0]!, /^bytes=0-\d+$/);
    const start = Number(/^bytes=(\d+)-$/.exec(ranges[1]!)![1]);
    assert.ok(start >= firstMissing); // the received part of an interrupted packet is not requested again
    assert.equal(notes.seen!.bytes, file.length - start);
  });

  test("the whole file is read if the range request fails", async () => {
    const store = new PacketStore(),
      notes = new Notes(store);
    await served([cut, whole, whole], async (url) => {
      const visit = new HttpFile(url);
      await assert.rejects(receiveFile(visit, notes, store));
      assert.equal(await receiveFile(visit, notes, store), "complete");
    });
    assert.equal(store.count, notes.head_!.manifest.numPackets);
  });
}

test("only HTTP errors that a retry cannot resolve are final", async () => {
  for (const [status, final] of [
    [404, true],
    [503, false],
    [429, false],
  ] as const) {
    const refuse: Answer = (_, response) => void response.writeHead(status).end();
    await served([refuse, refuse], async (url) => {
      const store = new PacketStore();
      await assert.rejects(receiveFile(new HttpFile(url), new Notes(store), store), (error: unknown) => {
        assert.ok(error instanceof HttpError);
        assert.equal(error.final, final);
        return true;
      });
    });
  }
});
