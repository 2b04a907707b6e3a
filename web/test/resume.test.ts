import assert from "node:assert/strict";
import { createServer, type IncomingMessage, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { test } from "node:test";

import type { Head } from "../src/packets/container.ts";
import type { Arrived, Counts, Listener } from "../src/transport/events.ts";
import { Held } from "../src/transport/held.ts";
import { partOf, recordsOf } from "../src/transport/kept.ts";
import { Refused } from "../src/transport/refused.ts";
import { receiveFile } from "../src/transport/reliable.ts";
import { retrying } from "../src/transport/retry.ts";
import { fileOf, STREAMS } from "./vectors.ts";

const packet = (place: number, size: number): Arrived => ({ place, bytes: new Uint8Array(size).fill(place) });

test("the rest of a file begins at its first gap", () => {
  const held = new Held();
  assert.equal(held.rest, null);
  held.begin(new Uint8Array(100));
  assert.deepEqual([held.rest!.place, held.rest!.offset], [0, 100]);
  assert.equal(held.add([packet(1, 30), packet(2, 40)]).length, 2);
  assert.deepEqual([held.rest!.place, held.rest!.offset], [0, 100]);
  assert.equal(held.add([packet(0, 20), packet(1, 30)]).length, 1);
  assert.deepEqual([held.rest!.place, held.rest!.offset, held.count], [3, 100 + 3 * 4 + 90, 3]);
  assert.deepEqual([...held.rest!.tail], new Array(40).fill(2));
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
    if (!this.held.begun) this.held.begin(file);
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
  const cut: Answer = (_, response) => {
    response.setHeader("Content-Length", file.length);
    response.write(file.subarray(0, Math.floor(0.7 * file.length)), () => response.destroy());
  };
  const part: Answer = (request, response) => {
    const from = Number(/bytes=(\d+)-/.exec(request.headers.range!)![1]);
    response.writeHead(206, { "Content-Range": `bytes ${from}-${file.length - 1}/${file.length}` });
    response.end(file.subarray(from));
  };
  const other: Answer = (request, response) => {
    const from = Number(/bytes=(\d+)-/.exec(request.headers.range!)![1]);
    response.writeHead(206);
    response.end(file.subarray(from).map((byte) => byte ^ 1));
  };

  test("a file that broke off is asked for from there on", async () => {
    const held = new Held(),
      notes = new Notes(held);
    const ranges = await served([cut, part], async (url) => {
      await assert.rejects(receiveFile(url, notes, held, null));
      assert.ok(held.count > 0 && held.count < notes.head_!.manifest.numPackets);
      const { offset, tail } = held.rest!;
      assert.equal(await receiveFile(url, notes, held, notes.head_), "complete");
      assert.equal(held.count, notes.head_!.manifest.numPackets);
      assert.equal(notes.seen!.bytes, file.length - offset + tail.length);
    });
    assert.equal(ranges[0], undefined);
    assert.match(ranges[1]!, /^bytes=\d+-$/);
  });

  test("nothing is taken for the rest of another file; one without ranges comes whole", async () => {
    for (const answers of [
      [cut, other, whole],
      [cut, whole],
    ]) {
      const held = new Held(),
        notes = new Notes(held);
      await served(answers, async (url) => {
        await assert.rejects(receiveFile(url, notes, held, null));
        assert.equal(await receiveFile(url, notes, held, notes.head_), "complete");
      });
      assert.equal(held.count, notes.head_!.manifest.numPackets);
    }
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
      await assert.rejects(receiveFile(url, new Notes(held), held, null), (error: unknown) => {
        assert.ok(error instanceof Refused);
        assert.equal(error.final, final);
        return true;
      });
    });
  }
});
