import assert from "node:assert/strict";
import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { test } from "node:test";

import type { Head } from "../src/packets/container.ts";
import type { Arrived, Counts, Listener } from "../src/transport/events.ts";
import { Held } from "../src/transport/held.ts";
import { HttpFile } from "../src/transport/http_file.ts";
import { partOf, recordsOf } from "../src/transport/kept.ts";
import { Refused } from "../src/transport/refused.ts";
import { receiveFile } from "../src/transport/reliable.ts";
import { retrying } from "../src/transport/retry.ts";
import { fileOf, STREAMS } from "./vectors.ts";

const packet = (place: number, size: number): Arrived => ({ place, bytes: new Uint8Array(size).fill(place) });

const HEAD = { manifest: { numPackets: 5 }, sideInfo: new Uint8Array() } as unknown as Head;

test("gaps of a file are known as far as the sizes before them", () => {
  const held = new Held();
  assert.deepEqual(held.gaps, []);
  held.begin(new Uint8Array(100), HEAD);
  assert.deepEqual(held.gaps, [{ place: 0, offset: 100, end: null }]);
  assert.equal(held.add([packet(1, 30), packet(2, 40)]).length, 2);
  assert.deepEqual(held.gaps, [{ place: 0, offset: 100, end: null }]);
  held.noteSize(0, 20); // it came damaged
  assert.deepEqual(held.gaps, [
    { place: 0, offset: 100, end: 124 },
    { place: 3, offset: 202, end: null },
  ]);
  assert.equal(held.add([packet(0, 20), packet(1, 30)]).length, 1);
  assert.deepEqual(held.gaps, [{ place: 3, offset: 202, end: null }]);
  held.add([packet(3, 1), packet(4, 1)]);
  assert.deepEqual([held.gaps, held.complete], [[], true]);
});

test("what is kept is read again, as far as it is whole", () => {
  const packets = [packet(7, 20), packet(3, 0), packet(0xffffffff, 5)],
    bytes = partOf(packets);
  assert.deepEqual(recordsOf(bytes), packets);
  assert.deepEqual(recordsOf(bytes.subarray(0, bytes.length - 1)), packets.slice(0, 2));
});

test("an attempt that fails is made again, later and later, until nothing could help", async () => {
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
    helps: (error: unknown) => (error as Error).message !== "d",
    progress: () => arrived,
    lost: (reason: string) => void reasons.push(reason),
    wait: async (ms: number) => void waits.push(ms),
  };
  await assert.rejects(retrying(attempt, how), /d/);
  assert.deepEqual(reasons, ["a", "b", "c", "got some"]);
  assert.deepEqual(waits, [500, 1000, 2000, 500]);
  assert.equal(await retrying(attempt, how), "complete");
});

class Notes implements Listener {
  head_: Head | null = null;
  seen: Counts | null = null;

  constructor(readonly held: Held) {}

  preview(): void {}

  head(head: Head, file: Uint8Array): void {
    this.head_ = head;
    if (!this.held.begun) this.held.begin(file, head);
  }

  packets(packets: readonly Arrived[]): void {
    this.held.add(packets);
  }

  counts(counts: Counts): void {
    this.seen = counts;
  }

  stopped(): boolean {
    return false;
  }
}

type Answer = (request: IncomingMessage, response: ServerResponse) => void;

/** A server whose answers follow one another; what it was asked for. */
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

  test("a file that broke off is asked for from there on", async () => {
    const held = new Held(),
      notes = new Notes(held);
    const ranges = await served([cut, part], async (url) => {
      const visit = new HttpFile(url);
      await assert.rejects(receiveFile(visit, notes, held));
      assert.ok(held.count > 0 && held.count < notes.head_!.manifest.numPackets);
      const { offset } = held.gaps[0];
      assert.equal(await receiveFile(visit, notes, held), "complete");
      assert.equal(held.count, notes.head_!.manifest.numPackets);
      assert.equal(notes.seen!.bytes, file.length - offset);
    });
    assert.match(ranges[0]!, /^bytes=0-\d+$/);
    assert.match(ranges[1]!, /^bytes=\d+-$/);
  });

  test("where the rest does not come by itself, the whole file is read", async () => {
    const held = new Held(),
      notes = new Notes(held);
    await served([cut, whole, whole], async (url) => {
      const visit = new HttpFile(url);
      await assert.rejects(receiveFile(visit, notes, held));
      assert.equal(await receiveFile(visit, notes, held), "complete");
    });
    assert.equal(held.count, notes.head_!.manifest.numPackets);
  });
}

test("a server's refusal is final where asking again cannot help", async () => {
  for (const [status, final] of [
    [404, true],
    [503, false],
    [429, false],
  ] as const) {
    const refuse: Answer = (_, response) => void response.writeHead(status).end();
    await served([refuse], async (url) => {
      const held = new Held();
      await assert.rejects(receiveFile(new HttpFile(url), new Notes(held), held), (error: unknown) => {
        assert.ok(error instanceof Refused);
        assert.equal(error.final, final);
        return true;
      });
    });
  }
});
