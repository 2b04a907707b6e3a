// Faults of file servers, proxies and browser caches. The visitor gets the whole scene, or a correct error.

import assert from "node:assert/strict";
import { test } from "node:test";

import { ContainerReader } from "../src/packets/container.ts";
import { FILE_ORDER, type Listener } from "../src/transport/events.ts";
import { HttpFile, readRange } from "../src/transport/http_file.ts";
import { receiveFile } from "../src/transport/http_source.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { HEAD, partOf } from "../src/transport/packet_cache.ts";
import { isIntact, PacketStore, SIZE_BYTES } from "../src/transport/packet_store.ts";
import { WorkerReceiver } from "../src/worker_receiver.ts";
import {
  type Answering,
  type Asked,
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
  assert.equal(reception.store.isSame(file), true, "another stream");
}

/** Checks that no cached packet is damaged or of another stream. */
function assertIntact(caches: Caches, file: Uint8Array): void {
  const container = new ContainerReader();
  container.feed(file);
  for (const { order, position, bytes } of caches.records)
    assert.ok(order === HEAD || isIntact(bytes, container.head!), `packet ${position} of ${order} is damaged`);
}

/** Answers with the first half of a range; `honest` is true if the headers say so. */
function shortened(file: Uint8Array, asked: Asked, honest: boolean): Response {
  if (!asked.range) return whole(file);
  const [first, end] = [asked.range[0], Math.min(asked.range[1], file.length)],
    half = first + Math.ceil((end - first) / 2);
  if (honest) return part(file, { ...asked, range: [first, half] });
  const headers = { "Content-Range": `bytes ${first}-${end - 1}/${file.length}` };
  return new Response(file.slice(first, half), { status: 206, headers });
}

for (const [kind, file] of KINDS) {
  const other = otherStream(file),
    offsets = packetOffsets(file);

  test(`${kind}: the first request is a range, caches are used, and little is transferred twice`, async () => {
    const server = new Server((asked) => part(file, asked));
    assertWhole(await visit(), file);
    assert.deepEqual(server.asked[0].range, [0, LIMITS.firstBytes]);
    assert.deepEqual([...new Set(server.asked.map(({ cache }) => cache))], ["default"]);
    assert.ok(server.bytes(file.length) <= 1.3 * file.length, `${server.bytes(file.length)} of ${file.length} bytes`);
  });

  test(`${kind}: a server without ranges delivers the whole file on every visit`, async () => {
    for (const size of [100, 700, 5000, file.length]) {
      const caches = new Caches();
      const server = new Server(() => whole(file, {}, size));
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
      assert.ok(server.asked.length <= 3);
    }
  });

  test(`${kind}: a server that sends half of each range delivers the whole stream`, async () => {
    const server = new Server((asked) => shortened(file, asked, true)),
      caches = new Caches();
    for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
    assert.ok(server.asked.length < 160, `${server.asked.length} requests`);
  });

  test(`${kind}: ranges that are cut without a word are not called another file`, async () => {
    const server = new Server((asked) => shortened(file, asked, false)),
      caches = new Caches();
    for (let n = 0; n < 2; n++) {
      const { text, reception } = await visit(caches);
      assert.match(text, /^(complete|\d+ packets? (is|are) damaged or not in the file)$/);
      assert.equal(reception.store.isSame(file), true);
    }
    assert.ok(server.asked.length < 160, `${server.asked.length} requests`);
  });

  test(`${kind}: a repeated visit requests only the manifest`, async () => {
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

  test(`${kind}: the Gaussians of the default viewpoint are the same in a repeated visit`, async () => {
    const caches = new Caches(),
      found: FromWorker[][] = [];
    new Server((asked) => part(file, asked));
    for (let n = 0; n < 2; n++) {
      const { said } = await visit(caches);
      found.push(said.filter((one) => one.kind === "framing"));
      assert.equal(found[n].length, kind === "still" ? 0 : 1);
    }
    assert.deepEqual(found[0], found[1]);
  });

  test(`${kind}: a file replaced between visits is received from the beginning`, async () => {
    for (const answering of [(asked) => part(other, asked), () => whole(other)] satisfies Answering[]) {
      const caches = new Caches(),
        server = new Server((asked) => part(file, asked));
      assertWhole(await visit(caches), file);
      server.answering = answering;
      const second = await visit(caches);
      assertWhole(second, other);
      assert.equal(second.said.filter(({ kind: one }) => one === "info").length, 1, "the old scene was shown");
      assertIntact(caches, other);
      assertWhole(await visit(caches), other);
    }
  });

  test(`${kind}: a file replaced between two requests is restarted once`, async () => {
    for (let last = 1; last < 4; last++) {
      const caches = new Caches(),
        server = new Server((asked, n) => part(n < last ? file : other, asked));
      const ended = await visit(caches);
      if (ended.reception.store.isSame(file)) continue; // the first file was complete before the change
      assertWhole(ended, other);
      assert.ok(server.bytes(file.length) < 3.5 * file.length, "more than one new beginning");
      assertIntact(caches, other);
    }
  });

  for (const rest of ["is of the new one", "is refused"] as const)
    test(`${kind}: a replaced file arrives although a proxy has its former beginning; the rest ${rest}`, async () => {
      const KEPT = 4096, // the proxy has this many bytes of the former file, under the address with the file's tag
        server = new Server((asked) => {
          const [first, end] = asked.range ?? [0, Infinity];
          if (server.asked.length > 60) return new Response(null, { status: 404 }); // ends the visit
          if (!asked.url.includes("?")) return part(other, asked);
          if (first >= KEPT && rest === "is refused") throw new TypeError("Failed to fetch");
          if (first >= KEPT) return part(other, asked);
          const answer = part(file, asked);
          if (Math.min(end, file.length) <= KEPT) return answer;
          return begun(file.slice(first, KEPT), { status: answer.status, headers: answer.headers }, "breaks");
        });
      assertWhole(await visit(null, { file: "https://scenes.example/streams/a.swz?0123456789abcdef" }), other);
      assert.ok(server.asked.length < 20, `${server.asked.length} requests`);
    });

  test(`${kind}: a file replaced all the time ends with an error`, async () => {
    const server = new Server((asked, n) => part(n % 2 ? file : other, asked)),
      { text } = await visit();
    assert.ok(text === "complete" || /replaced|damaged|no splatwire/.test(text), text);
    assert.ok(server.asked.length < 60, `${server.asked.length} requests`);
  });

  test(`${kind}: a bit error on the path is repaired by another request, at any offset`, async () => {
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

  test(`${kind}: a bit error in the manifest of a repeated visit discards nothing`, async () => {
    for (const at of [5, 7, 12, 200, 400]) {
      const caches = new Caches(),
        server = new Server((asked) => part(file, asked));
      assertWhole(await visit(caches), file);
      const before = server.asked.length;
      server.answering = (asked, n) => part(n === before ? flipped(file, at) : file, asked);
      assertWhole(await visit(caches), file);
      const ends = server.asked.slice(before).map(({ range }) => range?.[1] ?? Infinity);
      assert.ok(ends.length === 2 && ends.every((end) => end < 1000), `requests to ${ends}`);
    }
  });

  test(`${kind}: connections that break after two packets deliver the whole stream`, async () => {
    const most = 100 + 2 * Math.max(...offsets.map((offset, n) => (offsets[n + 1] ?? file.length) - offset)),
      caches = new Caches(),
      server = new Server((asked) => {
        const answer = part(file, asked),
          [first, end] = asked.range ?? [0, Infinity],
          cut = Math.max(first, offsets[0]) + most;
        if (answer.status === 416 || Math.min(end, file.length) <= cut) return answer;
        if (server.asked.length > 200) return new Response(null, { status: 404 }); // ends the visit
        return begun(file.slice(first, cut), { status: answer.status, headers: answer.headers }, "breaks");
      });
    for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
    assert.ok(server.asked.length < 160, `${server.asked.length} requests`);
  });

  for (const ends of ["breaks", "hangs"] as const)
    test(`${kind}: where every answer ${ends} within a head, packet or tile, the next one continues`, async () => {
      const most = 300,
        server = new Server((asked) => {
          const answer = part(file, asked),
            [first, end] = asked.range ?? [0, Infinity];
          if (answer.status === 416 || Math.min(end, file.length) <= first + most) return answer;
          if (server.asked.length > 200) return new Response(null, { status: 404 }); // ends the visit
          return begun(file.slice(first, first + most), { status: answer.status, headers: answer.headers }, ends);
        });
      const openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, idleMs: 20 });
      const sizes = offsets.map((offset, n) => (offsets[n + 1] ?? file.length) - offset);
      assert.ok(most < Math.min(offsets[0], Math.max(...sizes)), "the head or every packet arrives at once");
      assertWhole(await visit(null, {}, { openFile }), file);
      assert.ok(server.asked.filter(({ range }) => !range).length <= 1, "the whole file was requested repeatedly");
    });

  test(`${kind}: a file that is replaced while its head is continued is received from its beginning`, async () => {
    const server = new Server((asked, n) =>
      n ? part(other, asked) : begun(file.slice(0, 300), { status: 206, headers: part(file, asked).headers }, "breaks"),
    );
    assertWhole(await visit(), other);
    assert.ok(server.asked.every(({ range }) => range));
  });

  test(`${kind}: a bit error in the server's file costs only its packet`, async () => {
    const caches = new Caches(),
      server = new Server((asked) => part(flipped(file, offsets[3] + 40), asked)),
      { text, complete, reception } = await visit(caches);
    assert.match(text, /damaged/);
    assert.equal(complete, false);
    assert.equal(reception.store.count, offsets.length - 1);
    assert.ok(server.asked.length < 30);
    assertIntact(caches, file);
    server.answering = (asked) => part(file, asked); // the file is repaired
    assertWhole(await visit(caches), file);
  });

  test(`${kind}: an answer that never arrives or stalls is requested again`, async () => {
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
    ["have other bytes, with a matching header", (asked) => shifted(file, asked, true)],
    ["have other bytes, without a header", (asked) => shifted(file, asked, false)],
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
      "have the whole file, without a header",
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
    test(`${kind}: the whole file is read if range responses ${name}`, async () => {
      const caches = new Caches(),
        server = new Server(answering);
      assertWhole(await visit(caches), file);
      assert.ok(server.asked.length === 1 || server.asked.at(-1)!.range === null);
      assert.ok(server.asked.length < 12);
      assertWhole(await visit(caches), file);
    });

  test(`${kind}: the rest of a short range response is requested`, async () => {
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

  test(`${kind}: Retry-After of a busy server is respected`, async () => {
    const waits: number[] = [];
    new Server((asked, n) =>
      n < 2 ? new Response(null, { status: 429, headers: { "Retry-After": "7" } }) : part(file, asked),
    );
    const ended = await visit(null, {}, { wait: async (ms) => void waits.push(ms) });
    assertWhole(ended, file);
    assert.deepEqual(waits, [7000, 7000]);
  });

  test(`${kind}: a date of Retry-After is respected`, async () => {
    const waits: number[] = [],
      date = new Date(Date.now() + 3_600_000).toUTCString();
    new Server((asked, n) =>
      n < 1 ? new Response(null, { status: 503, headers: { "Retry-After": date } }) : part(file, asked),
    );
    assertWhole(await visit(null, {}, { wait: async (ms) => void waits.push(ms) }), file);
    assert.deepEqual(waits, [60_000]); // the limit
  });

  test(`${kind}: a failing, full or corrupt browser cache does not prevent a complete scene`, async () => {
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
      head = caches.records.find(({ order }) => order === HEAD)!.bytes;
    const odd: Uint8Array[] = [
      new Uint8Array(), // an empty entry
      bytes.subarray(0, Math.floor(bytes.length * 0.6)),
      flipped(bytes, 30),
      flipped(bytes, bytes.length - 9),
      partOf([{ order: HEAD, position: 0, bytes: head }]),
      partOf([{ order: HEAD, position: 0, bytes: head.subarray(0, 300) }]),
      partOf([
        { order: HEAD, position: 0, bytes: head },
        { order: FILE_ORDER, position: 2 ** 40, bytes: new Uint8Array(40) },
      ]),
      partOf([{ order: FILE_ORDER, position: 2, bytes: new Uint8Array(40) }]),
      partOf([{ order: HEAD, position: 0, bytes: otherStream(file).slice(0, 1200) }]),
    ];
    for (const one of odd) {
      caches.entries.clear();
      caches.entries.set(key, one.slice() as Uint8Array<ArrayBuffer>);
      for (let n = 0; n < 2; n++) assertWhole(await visit(caches), file);
      assertIntact(caches, file);
    }
    assert.ok(server.asked.length > 0);
  });

  test(`${kind}: concurrent tabs with one or two versions of a stream leave a valid cache`, async () => {
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

  test(`${kind}: the cached stream is shown while the server is unreachable and revalidated later`, async () => {
    const caches = new Caches(),
      server = new Server((asked) => part(file, asked));
    assertWhole(await visit(caches), file);
    let down = 3;
    server.answering = (asked) => (down-- > 0 ? Promise.reject(new TypeError("Failed to fetch")) : part(other, asked));
    const ended = await visit(caches);
    assert.ok(ended.lost.length > 0);
    assert.equal(ended.said.filter(({ kind: one }) => one === "info").length, 2, "the old scene, then the new one");
    assertWhole(ended, other);
  });
}

const hanging = (): Promise<Response> => new Promise(() => undefined);
const failures: [string, (asked: Parameters<Answering>[0]) => Response | Promise<Response>, RegExp][] = [
  ...[429, 500, 502, 503, 504].map((status): (typeof failures)[number] => [
    `answer ${status}`,
    () => new Response(null, { status }),
    new RegExp(`answers ${status}`),
  ]),
  ["are never answered", hanging, /sent nothing/],
  ["break", () => Promise.reject(new TypeError("network error")), /network error/],
  [
    "fall silent after some bytes",
    ({ range }) => begun(LEVELS.slice(range![0], range![0] + 100), { status: 206 }, "hangs"),
    /sent nothing/,
  ],
];
for (const [name, fail, reason] of failures)
  test(`where requests for parts ${name}, the whole file is requested after some attempts`, async () => {
    for (const later of [0, 1]) {
      const waits: number[] = [],
        caches = new Caches(),
        server = new Server((asked, n) =>
          asked.range && (n || !later) ? fail(asked) : asked.range ? part(LEVELS, asked) : whole(LEVELS),
        );
      const ways = {
        openFile: (url: string): HttpFile => new HttpFile(url, { ...LIMITS, idleMs: 20 }),
        wait: async (ms: number): Promise<void> => void waits.push(ms),
      };
      const ended = await visit(caches, {}, ways);
      assertWhole(ended, LEVELS);
      assert.equal(server.asked.at(-1)!.range, null);
      assert.ok(server.asked.length < 12, `${server.asked.length} requests`);
      for (const one of ended.lost) assert.match(one, reason);
      assert.ok(
        waits.every((ms, n) => ms >= 500 && (n === 0 || ms >= waits[n - 1])),
        waits.join(),
      );
    }
  });

for (const status of [401, 403, 404, 410])
  test(`where requests for parts answer ${status}, the whole file is requested at once`, async () => {
    const server = new Server((asked) => (asked.range ? new Response(null, { status }) : whole(LEVELS)));
    assertWhole(await visit(), LEVELS);
    assert.equal(server.asked.length, 2);
  });

test("messages about a server do not contain the token in its address", async () => {
  const answers: Answering[] = [
    () => new Response(null, { status: 403 }),
    () => new Response(null, { status: 416 }),
    (asked, n) => (n ? new Response(null, { status: 401 }) : part(LEVELS, asked)),
    () => Promise.reject(new TypeError("Failed to fetch")),
  ];
  for (const answering of answers) {
    let failures = 0;
    new Server((asked, n) => (failures > 20 ? part(LEVELS, asked) : answering(asked, n)));
    const { text, lost } = await visit(null, { file: `${URL_}?token=secret` }, { wait: async () => void failures++ });
    assert.doesNotMatch([text, ...lost].join(), /secret/);
  }
});

test("where the whole file is refused for another reason than parts of it, both reasons are said", async () => {
  new Server((asked) => new Response(null, { status: asked.range ? 503 : 403 }));
  const { text, complete } = await visit();
  assert.match(text, /answers 403.*for parts of it: .*answers 503/);
  assert.equal(complete, false);
});

test("a server that fails for a while is requested for parts again after the whole file failed, too", async () => {
  const server = new Server((asked, n) => (n < 6 ? new Response(null, { status: 503 }) : part(STILL, asked)));
  assertWhole(await visit(), STILL);
  assert.deepEqual(
    server.asked.slice(0, 7).map(({ range }) => range !== null),
    [true, true, true, false, true, true, true],
  );
});

test("responses that the page may not read (CORS) are named by their header, and retried", async () => {
  for (const type of ["opaque", "basic", ""] as const) {
    let attempts = 0;
    globalThis.fetch = async (_, init) => {
      if (init?.mode === "no-cors" && type) return { type } as Response;
      if (init?.mode !== "no-cors" && ++attempts > 20) return part(STILL, { ...NO_RANGE, signal: init!.signal! });
      throw new TypeError("Failed to fetch");
    };
    const ended = await visit();
    assertWhole(ended, STILL); // a proxy that sends 502 without the header has its server again
    const named = ended.lost.findIndex((reason) => /may not read it.*Access-Control-Allow-Origin/.test(reason));
    assert.equal(named, type === "opaque" ? 2 : -1, ended.lost.join("; "));
  }
});

const NO_RANGE = { range: null, cache: "default", url: URL_ } as const;

function shifted(file: Uint8Array, asked: Parameters<Answering>[0], honest: boolean): Response {
  if (!asked.range) return whole(file);
  const range = [asked.range[0] + 4, asked.range[1] + 4] as const,
    answer = part(file, { ...asked, range });
  if (honest) return answer;
  return new Response(answer.body, { status: answer.status });
}

test("an HTML page instead of a stream is an error after a few requests", async () => {
  const server = new Server(() => whole(new TextEncoder().encode("<!doctype html><title>Welcome</title>".repeat(99)))),
    { text } = await visit();
  assert.match(text, /not a splatwire stream/);
  assert.ok(server.asked.length <= 4);
});

test("a file that is still being copied to the server is requested again, a limited number of times", async () => {
  for (const size of [0, 300]) {
    const server = new Server((asked, n) => part(n < 6 ? CLIP.subarray(0, size) : CLIP, asked));
    assertWhole(await visit(), CLIP);
    server.answering = (asked) => part(CLIP.subarray(0, size), asked);
    const before = server.asked.length;
    assert.match((await visit()).text, /ends before its side information/);
    assert.ok(server.asked.length - before < 20);
  }
});

test("a login page instead of the stream does not clear the cache", async () => {
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

test("a file truncated on the server ends early with the available packets", async () => {
  const server = new Server((asked) => part(STILL.subarray(0, STILL.length - 500), asked)),
    { text, complete, reception } = await visit();
  assert.match(text, /not in the file/);
  assert.equal(complete, false);
  assert.ok(reception.store.count > 0);
  assert.ok(server.asked.length < 12);
});

test("a file that repeats one packet without end is given up with the packets that arrived", async () => {
  const [first, second] = packetOffsets(STILL).map((offset) => offset - 4);
  let mostSent = 0;
  const endless = (): Response => {
    let sent = 0;
    return new Response(
      new ReadableStream<Uint8Array>({
        start: (controller) => controller.enqueue(STILL.slice(0, first)),
        pull: (controller) => {
          const packet = STILL.subarray(first, second),
            piece = new Uint8Array(1000 * packet.length);
          for (let n = 0; n < 1000; n++) piece.set(packet, n * packet.length);
          sent += piece.length;
          mostSent = Math.max(mostSent, sent);
          if (sent > 2 ** 26) controller.close();
          else controller.enqueue(piece);
        },
      }),
    );
  };
  const server = new Server(endless),
    { text, complete, reception } = await visit();
  assert.match(text, /not in the file/);
  assert.deepEqual([complete, reception.store.count], [false, 1]);
  assert.ok(mostSent < 2 ** 24, `${mostSent} bytes`);
  assert.ok(server.asked.length < 12);
});

test("a listener without a `changed` method receives a replaced file", async () => {
  const server = new Server((asked, n) => part(n < 2 ? STILL : otherStream(STILL), asked)),
    store = new PacketStore();
  const listener: Listener = {
    preview: () => undefined,
    head: (head, bytes) => void (store.hasHead || store.begin(bytes, head)),
    packets: (packets) => void store.add(packets),
    counts: () => undefined,
    stopped: () => false,
  };
  for (const answering of [server.answering, () => whole(otherStream(otherStream(STILL)))] satisfies Answering[]) {
    server.answering = answering;
    assert.equal(await receiveFile(new HttpFile(URL_, LIMITS), listener, store), "complete");
  }
  assert.equal(store.isSame(otherStream(STILL)), true);
});

test("all arriving packets are decoded after a reset", async () => {
  new Server((asked) => part(STILL, asked));
  const { reception } = await visit();
  reception.changed();
  const container = new ContainerReader(),
    packets = container.feed(STILL).map((bytes, position) => ({ order: "session", position, bytes }));
  reception.head(container.head!, container.headBytes, true);
  reception.packets([]);
  reception.packets(packets.slice(0, 2));
  reception.packets([]);
  await reception.settled();
  reception.packets(packets);
  await reception.settled();
  assert.equal(reception.complete, true);
});

test("a check during decoding waits for the received packets, and keeps them in the cache", async () => {
  const caches = new Caches();
  new Server((asked) => part(STILL, asked));
  await visit(caches);
  const said: FromWorker[] = [];
  Object.assign(globalThis, { self: { postMessage: (message: FromWorker) => said.push(message) } });
  const reception = new WorkerReceiver();
  await reception.resume(URL_); // all packets, which are not decoded yet
  assert.deepEqual([reception.store.complete, reception.complete], [true, false]);
  await reception.digest();
  await reception.settled();
  assert.deepEqual(
    said.filter(({ kind }) => kind === "digest"),
    [{ kind: "digest", isVerified: true }],
  );
  assert.ok(caches.records.length > 1);
});

test("a scene without a server is not cached: its address is never used again", async () => {
  for (const [file, entries] of [
    ["blob:https://scenes.example/e1424ea9", 0],
    ["data:application/octet-stream;base64,AAAA", 0],
    [URL_, 1],
  ] as const) {
    const caches = new Caches();
    new Server((asked) => part(STILL, asked));
    assert.equal((await visit(caches, { file })).verified, true);
    assert.equal(caches.entries.size > 0, entries > 0, file);
  }
});

test("a file of which the server has sent a part is requested again while a web page is in its place", async () => {
  const page = () => new Response("<!doctype html>");
  const back = new Server((asked, n) => (n > 0 && n < 6 ? page() : part(CLIP, asked)));
  assert.equal((await visit()).verified, true);
  assert.ok(
    back.asked.slice(6).every(({ range }) => range),
    "only the missing parts are requested afterwards",
  );
  const server = new Server((asked, n) => (n > 0 ? page() : part(CLIP, asked)));
  assert.equal((await visit()).text, "this is not a splatwire stream");
  assert.ok(server.asked.length < 20, `${server.asked.length} requests`);
});

test("a login page in place of a file is named, also after a part of the file", async () => {
  const login = (): Response =>
    new Response("<!doctype html>", { headers: { "Content-Type": "text/html; charset=utf-8" } });
  for (const first of [0, 1]) {
    new Server((asked, n) => (n >= first ? login() : part(CLIP, asked)));
    assert.equal((await visit()).text, `${URL_} is a web page, such as a login`);
  }
});

for (const [place, range] of [
  ["first", [0, LIMITS.firstBytes]],
  ["last", [1, CLIP.length]],
] as const)
  test(`a worker that always gives the ${place} part is named, and the stream goes on after it`, async () => {
    const same = (asked: Asked): Response => part(CLIP, { ...asked, range: [...range] }),
      server = new Server((asked, n) => (n < 9 ? same(asked) : part(CLIP, asked))),
      { complete, verified, lost } = await visit();
    assert.deepEqual([complete, verified], [true, true]);
    assert.ok(lost.length > 1 && server.asked.length < 20);
    for (const reason of lost) assert.match(reason, /answers with a part of it/);
  });

test("bytes of broken ranges are counted once, also if they end a head and begin a packet", async () => {
  const store = new PacketStore(),
    listener: Listener = {
      preview: () => undefined,
      head: (head, bytes) => store.begin(bytes, head),
      packets: (packets) => void store.add(packets),
      counts: () => undefined,
      stopped: () => false,
    },
    file = new HttpFile(URL_, { ...LIMITS, firstBytes: STILL.length }),
    size = packetOffsets(STILL)[0] - SIZE_BYTES,
    counts = [0];
  while (!file.isTryingWhole) file.noteFailure(new Error("broken"), false);
  file.noteFailure(new Error("broken"), false); // the whole file failed, too
  const server = new Server((asked, n) => {
    const bytes = STILL.slice(asked.range![0], [size - 9, size + 7][n]);
    return begun(bytes, { status: 206, headers: part(STILL, asked).headers }, "breaks");
  });
  for (let n = 0; n < 2; n++) {
    await assert.rejects(receiveFile(file, listener, store), /network error/);
    counts.push(file.numBegun);
  }
  assert.deepEqual(
    server.asked.map(({ range }) => range![0]),
    [0, size - 9],
  );
  assert.ok(store.hasHead && file.hasBegun(size));
  assert.deepEqual(counts, [0, size - 9, size - 9 + 7]);
});

for (const isReplaced of [false, true])
  test(`an aborted request keeps ${isReplaced ? "no bytes of a replaced file" : "its bytes"}`, async () => {
    const file = new HttpFile(URL_, { ...LIMITS, idleMs: 20 }),
      aborted = new AbortController();
    new Server((asked) => begun(STILL.slice(100, 400), { status: 206, headers: part(STILL, asked).headers }, "hangs"));
    const read = readRange(file, 100, 1000, 900, "default", aborted.signal);
    aborted.abort();
    if (isReplaced) file.noteChange();
    await assert.rejects(read);
    assert.equal(file.hasBegun(100), !isReplaced);
  });
