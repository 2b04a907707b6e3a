// Faults of file servers, of what lies between them and a page, and of what a browser has kept: a visitor gets the
// whole scene, or an honest end.

import assert from "node:assert/strict";
import { test } from "node:test";

import { ContainerReader } from "../src/packets/container.ts";
import type { Listener } from "../src/transport/events.ts";
import { Held } from "../src/transport/held.ts";
import { HttpFile } from "../src/transport/http_file.ts";
import { partOf } from "../src/transport/kept.ts";
import { isIntact } from "../src/transport/packet_reader.ts";
import { receiveFile } from "../src/transport/reliable.ts";
import {
  type Answering,
  begun,
  Caches,
  flipped,
  LIMITS,
  otherStream,
  packetOffsets,
  part,
  Server,
  URL_,
  type Visit,
  visit,
  whole,
} from "./fake_web.ts";
import { fileOf } from "./vectors.ts";

const LEVELS = fileOf("../tests/golden/tiny_levels.swz"),
  STILL = fileOf("../tests/golden/tiny_causal.swz"),
  CLIP = fileOf("../tests/golden/tiny_clip.swz");
const KINDS = [
  ["levels", LEVELS],
  ["still", STILL],
  ["clip", CLIP],
] as const;

function assertWhole({ text, complete, verified, reception }: Visit, file: Uint8Array): void {
  assert.deepEqual({ text, complete, verified }, { text: "complete", complete: true, verified: true });
  assert.equal(reception.held.isSame(file), true, "another stream");
}

/** Nothing is kept that is damaged or of another stream. */
function assertIntact(caches: Caches, file: Uint8Array): void {
  const container = new ContainerReader();
  container.feed(file);
  for (const { place, bytes } of caches.records)
    assert.ok(place === 0xffffffff || isIntact(bytes, container.head!), `packet ${place} is damaged`);
}

for (const [kind, file] of KINDS) {
  const other = otherStream(file),
    offsets = packetOffsets(file);

  test(`${kind}: the first request is for a part, no request passes caches by, and little comes twice`, async () => {
    const server = new Server((asked) => part(file, asked));
    assertWhole(await visit(), file);
    assert.deepEqual(server.asked[0].range, [0, LIMITS.firstBytes]);
    assert.deepEqual([...new Set(server.asked.map(({ cache }) => cache))], ["default"]);
    assert.ok(server.bytes(file.length) <= 1.3 * file.length, `${server.bytes(file.length)} of ${file.length} bytes`);
  });

  test(`${kind}: a server that ignores ranges gives all of it, every time`, async () => {
    for (const size of [100, 700, 5000, file.length]) {
      const caches = new Caches();
      const server = new Server(() => whole(file, {}, size));
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
      assert.ok(server.asked.length <= 3);
    }
  });

  test(`${kind}: a visitor who comes back requests the manifest and nothing else`, async () => {
    const caches = new Caches(),
      server = new Server((asked) => part(file, asked));
    assertWhole(await visit(caches), file);
    const before = server.asked.length;
    assertWhole(await visit(caches), file);
    assert.deepEqual(
      server.asked.slice(before).map(({ range, cache }) => [range![1] < 1000, cache]),
      [[true, "no-cache"]],
    );
  });

  test(`${kind}: a file that is replaced between visits is received from its beginning`, async () => {
    for (const answering of [(asked) => part(other, asked), () => whole(other)] satisfies Answering[]) {
      const caches = new Caches(),
        server = new Server((asked) => part(file, asked));
      assertWhole(await visit(caches), file);
      server.answering = answering;
      const second = await visit(caches);
      assertWhole(second, other);
      assert.equal(second.said.filter(({ kind: one }) => one === "facts").length, 1, "the old scene was shown");
      assertIntact(caches, other);
      assertWhole(await visit(caches), other);
    }
  });

  test(`${kind}: a file that is replaced between two requests is received from its beginning, once`, async () => {
    for (let last = 1; last < 4; last++) {
      const caches = new Caches(),
        server = new Server((asked, n) => part(n < last ? file : other, asked));
      const ended = await visit(caches);
      if (ended.reception.held.isSame(file)) continue; // complete before the file changed
      assertWhole(ended, other);
      assert.ok(server.bytes(file.length) < 3.5 * file.length, "more than one new beginning");
      assertIntact(caches, other);
    }
  });

  test(`${kind}: a file that is replaced all the time ends with a reason`, async () => {
    const server = new Server((asked, n) => part(n % 2 ? file : other, asked)),
      { text } = await visit();
    assert.ok(text === "complete" || /replaced|damaged|no splatwire/.test(text), text);
    assert.ok(server.asked.length < 60, `${server.asked.length} requests`);
  });

  test(`${kind}: a bit that flips on the way is requested again, wherever it is`, async () => {
    for (const at of [2, 6, 300, 700, offsets[0] - 3, offsets[0] + 1, offsets[2] + 30, offsets.at(-1)! + 20]) {
      const caches = new Caches();
      let done = false;
      new Server((asked) => {
        const [first, end] = asked.range ?? [0, Infinity],
          now = !done && first <= at && at < end;
        done ||= now;
        return part(now ? flipped(file, at) : file, asked);
      });
      assertWhole(await visit(caches), file);
      assertIntact(caches, file);
      assertWhole(await visit(caches), file);
    }
  });

  test(`${kind}: a bit that is flipped on the server costs its packet and nothing else`, async () => {
    const caches = new Caches(),
      server = new Server((asked) => part(flipped(file, offsets[3] + 40), asked)),
      { text, complete, reception } = await visit(caches);
    assert.match(text, /damaged/);
    assert.equal(complete, false);
    assert.equal(reception.held.count, offsets.length - 1);
    assert.ok(server.asked.length < 30);
    assertIntact(caches, file);
    server.answering = (asked) => part(file, asked); // it is repaired
    assertWhole(await visit(caches), file);
  });

  test(`${kind}: an answer that never comes, or stops, is given up and requested again`, async () => {
    const hangs: Answering[] = [
      () => new Promise(() => undefined),
      (asked) =>
        begun(
          part(file, asked).ok ? file.slice(asked.range![0], asked.range![0] + 100) : file,
          {
            status: 206,
            headers: { "Content-Range": part(file, asked).headers.get("content-range")! },
          },
          "hangs",
        ),
    ];
    for (const hang of hangs)
      for (const which of [0, 1]) {
        new Server((asked, n) => (n === which ? hang(asked, n) : part(file, asked)));
        const ended = await visit(null, {}, { openFile: (url) => new HttpFile(url, { ...LIMITS, idleMs: 50 }) });
        assertWhole(ended, file);
        assert.match(ended.lost[0], /sent nothing for/);
      }
  });

  const faults: [string, Answering][] = [
    ["are of other bytes, which they say", (asked) => shifted(file, asked, true)],
    ["are of other bytes, which they hide", (asked) => shifted(file, asked, false)],
    [
      "have the whole file",
      ({ range }) =>
        range
          ? new Response(file.slice(), {
              status: 206,
              headers: { "Content-Range": `bytes 0-${file.length - 1}/${file.length}` },
            })
          : whole(file),
    ],
    [
      "have the whole file, which they hide",
      ({ range }) => (range ? new Response(file.slice(), { status: 206 }) : whole(file)),
    ],
    ["are of a compressed object", (asked) => part(file, asked, asked.range ? { "Content-Encoding": "gzip" } : {})],
    [
      "cannot be decompressed",
      (asked) => (asked.range ? begun(new Uint8Array(), { status: 206 }, "breaks") : whole(file)),
    ],
    ["are refused", (asked) => (asked.range ? new Response(null, { status: 403 }) : whole(file))],
    ["are not implemented", (asked) => (asked.range ? new Response(null, { status: 501 }) : whole(file))],
    [
      "need a preflight that fails",
      (asked) => (asked.range ? Promise.reject(new TypeError("Failed to fetch")) : whole(file)),
    ],
    [
      "have several parts",
      (asked) => part(file, asked, asked.range ? { "Content-Type": "multipart/byteranges; boundary=x" } : {}),
    ],
    ["stop after the first", (asked) => (asked.range?.[0] ? new Response(null, { status: 403 }) : part(file, asked))],
    ["are of the whole file after the first", (asked) => (asked.range?.[0] ? whole(file) : part(file, asked))],
  ];
  for (const [name, answering] of faults)
    test(`${kind}: where answers to requests for a part ${name}, the whole file is read`, async () => {
      const caches = new Caches(),
        server = new Server(answering);
      assertWhole(await visit(caches), file);
      assert.ok(server.asked.length === 1 || server.asked.at(-1)!.range === null);
      assert.ok(server.asked.length < 12);
      assertWhole(await visit(caches), file);
    });

  test(`${kind}: a server that gives less than was requested is requested again for the rest`, async () => {
    for (const most of [1500, 3000]) {
      const server = new Server((asked) =>
        part(file, {
          ...asked,
          range: asked.range && [asked.range[0], Math.min(asked.range[1], asked.range[0] + most)],
        }),
      );
      assertWhole(await visit(), file);
      assert.ok(server.bytes(file.length) < 12 * file.length);
      assert.ok(server.asked.every(({ cache }) => cache === "default"));
    }
  });

  test(`${kind}: a busy server is requested again when it says`, async () => {
    const waits: number[] = [];
    new Server((asked, n) =>
      n < 2 ? new Response(null, { status: 429, headers: { "Retry-After": "7" } }) : part(file, asked),
    );
    const ended = await visit(null, {}, { wait: async (ms) => void waits.push(ms) });
    assertWhole(ended, file);
    assert.deepEqual(waits, [7000, 7000]);
  });

  test(`${kind}: a browser that keeps nothing, has no room, or kept something odd shows the whole scene`, async () => {
    const server = new Server((asked) => part(file, asked));
    for (const room of [0, 1]) {
      const caches = new Caches();
      caches.room = room;
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
    }
    const broken = {
      open: () => Promise.reject(new Error("denied")),
      delete: () => Promise.reject(new Error("denied")),
    };
    assertWhole(await visit(broken as unknown as Caches), file);
    const failing = new Caches();
    failing.open = async () => {
      const fail = (): Promise<never> => Promise.reject(new Error("broken"));
      return { keys: fail, match: fail, put: fail, delete: fail } as unknown as Cache;
    };
    assertWhole(await visit(failing), file);
    const caches = new Caches();
    assertWhole(await visit(caches), file);
    const [key, bytes] = [...caches.entries][0],
      head = caches.records.find(({ place }) => place === 0xffffffff)!.bytes;
    const odd: Uint8Array[] = [
      new Uint8Array(), // nothing of it was written
      bytes.subarray(0, Math.floor(bytes.length * 0.6)),
      flipped(bytes, 30),
      flipped(bytes, bytes.length - 9),
      partOf([{ place: 0xffffffff, bytes: head }]),
      partOf([{ place: 0xffffffff, bytes: head.subarray(0, 300) }]),
      partOf([
        { place: 0xffffffff, bytes: head },
        { place: 0xfffffff0, bytes: new Uint8Array(40) },
      ]),
      partOf([{ place: 2, bytes: new Uint8Array(40) }]),
      partOf([{ place: 0xffffffff, bytes: otherStream(file).slice(0, 1200) }]),
    ];
    for (const one of odd) {
      caches.entries.clear();
      caches.entries.set(key, one.slice() as Uint8Array<ArrayBuffer>);
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
      assertIntact(caches, file);
    }
    assert.ok(server.asked.length > 0);
  });

  test(`${kind}: tabs that keep a stream at once, or two versions of it, break no later visit`, async () => {
    for (const later of [file, other]) {
      const caches = new Caches(),
        server = new Server((asked) => part(file, asked));
      const first = visit(caches);
      await new Promise((resolve) => setTimeout(resolve, 5));
      server.answering = (asked) => part(later, asked);
      await first;
      await visit(caches);
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), later);
    }
  });

  test(`${kind}: what was kept is shown while the server cannot be reached, and compared when it can`, async () => {
    const caches = new Caches(),
      server = new Server((asked) => part(file, asked));
    assertWhole(await visit(caches), file);
    let down = 3;
    server.answering = (asked) => (down-- > 0 ? Promise.reject(new TypeError("Failed to fetch")) : part(other, asked));
    const ended = await visit(caches);
    assert.ok(ended.lost.length > 0);
    assert.equal(ended.said.filter(({ kind: one }) => one === "facts").length, 2, "the old scene, then the new one");
    assertWhole(ended, other);
  });
}

function shifted(file: Uint8Array, asked: Parameters<Answering>[0], honest: boolean): Response {
  if (!asked.range) return whole(file);
  const range = [asked.range[0] + 4, asked.range[1] + 4] as const,
    answer = part(file, { ...asked, range });
  if (honest) return answer;
  return new Response(answer.body, { status: answer.status });
}

test("a page that is no stream is an error after a few requests", async () => {
  const server = new Server(() => whole(new TextEncoder().encode("<!doctype html><title>Welcome</title>".repeat(99)))),
    { text } = await visit();
  assert.match(text, /not a splatwire stream/);
  assert.ok(server.asked.length <= 4);
});

test("a page of somebody else's server leaves what was kept alone", async () => {
  const caches = new Caches(),
    server = new Server((asked) => part(STILL, asked));
  assertWhole(await visit(caches), STILL);
  server.answering = () => whole(new TextEncoder().encode("<!doctype html><title>Sign in</title>".repeat(99)));
  assert.match((await visit(caches)).text, /no splatwire stream|not a splatwire stream/);
  server.answering = (asked) => part(STILL, asked);
  const before = server.asked.length;
  assertWhole(await visit(caches), STILL);
  assert.equal(server.asked.length, before + 1);
});

test("a file that is cut on the server ends early with what is there", async () => {
  const server = new Server((asked) => part(STILL.subarray(0, STILL.length - 500), asked)),
    { text, complete, reception } = await visit();
  assert.match(text, /not in the file/);
  assert.equal(complete, false);
  assert.ok(reception.held.count > 0);
  assert.ok(server.asked.length < 12);
});

test("a receiver that knows nothing of replaced files gets the new one, too", async () => {
  const server = new Server((asked, n) => part(n < 2 ? STILL : otherStream(STILL), asked)),
    held = new Held();
  const listener: Listener = {
    preview: () => undefined,
    head: (head, bytes) => void (held.begun || held.begin(bytes, head)),
    packets: (packets) => void held.add(packets),
    counts: () => undefined,
    stopped: () => false,
  };
  for (const answering of [server.answering, () => whole(otherStream(otherStream(STILL)))] satisfies Answering[]) {
    server.answering = answering;
    assert.equal(await receiveFile(new HttpFile(URL_, LIMITS), listener, held), "complete");
  }
  assert.equal(held.isSame(otherStream(STILL)), true);
});

test("nothing that arrives is left undecoded, whatever came before it", async () => {
  new Server((asked) => part(STILL, asked));
  const { reception } = await visit();
  reception.changed();
  const container = new ContainerReader(),
    packets = container.feed(STILL).map((bytes, place) => ({ place, bytes }));
  reception.head(container.head!, container.headBytes, true);
  reception.packets([]);
  reception.packets(packets.slice(0, 2));
  reception.packets([]);
  await reception.settled();
  reception.packets(packets);
  await reception.settled();
  assert.equal(reception.complete, true);
});
