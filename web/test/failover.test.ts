// Failover between sessions and files of a stream: final errors, retries, and the reason reported to the visitor.

import assert from "node:assert/strict";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { type Listener, UNKNOWN_ORDER } from "../src/transport/events.ts";
import type { Transports } from "../src/transport/failover.ts";
import { HttpFile } from "../src/transport/http_file.ts";
import {
  NoWebTransport,
  receiveDatagrams,
  type SessionAddress,
  type SessionOptions,
} from "../src/transport/webtransport.ts";
import type { WorkerReceiver } from "../src/worker_receiver.ts";
import { type Asked, Caches, LIMITS, otherStream, part, Server, stopClock, visit } from "./fake_web.ts";
import { fileOf, readStream } from "./vectors.ts";
import { welcome } from "./wire_messages.ts";

const STILL = fileOf("../tests/golden/tiny_causal.swz"),
  LEVELS = fileOf("../tests/golden/tiny_levels.swz"),
  CLIP = "../tests/golden/tiny_clip.swz",
  SESSION: SessionAddress = { url: "https://scenes.example:4840/splatwire" },
  SIGNED: SessionAddress = { ...SESSION, fingerprint: "1a" };

/** Sessions that end with these texts, one after another. Errors are thrown. */
function sessions(...ends: (string | Error)[]): { ways: Partial<Transports>; opened: SessionAddress[] } {
  const opened: SessionAddress[] = [];
  const receiveDatagrams = async (session: SessionAddress): Promise<string> => {
    opened.push(session);
    const end = ends.shift() ?? "complete";
    if (end instanceof Error) throw end;
    return end;
  };
  return { ways: { receiveDatagrams }, opened };
}

const noFile = (): Response => new Response(null, { status: 404, statusText: "Not Found" });
const down = (): Error => new Error("no answer to a WebTransport session");

test("joining a live clip is retried until the link is up", async () => {
  new Server(noFile);
  const { ways, opened } = sessions(down(), down(), down(), down()),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.equal(text, "complete");
  assert.equal(opened.length, 5);
  assert.equal(lost.length, 4);
  for (const reason of lost) assert.match(reason, /no answer to a WebTransport session/);
});

test("joining a live clip is retried while its server is full", async () => {
  new Server(noFile);
  const { ways } = sessions(new Error("the server is full")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual([text, lost.length], ["complete", 1]);
  assert.match(lost[0], /the server is full/);
});

/** Returns a server that never answers. Its clock runs while a request waits. */
function hangingServer({ advance }: ReturnType<typeof stopClock>): Server {
  return new Server(async ({ signal }) => {
    await advance(60_000, signal);
    return new Promise<Response>(() => undefined);
  });
}

test("joining a live clip opens the next session although the file of its name hangs", async (context) => {
  const server = hangingServer(stopClock(context)),
    { ways, opened } = sessions(down(), "complete"),
    openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, idleMs: 120_000 }),
    { text, lost } = await visit(null, { session: SESSION }, { ...ways, openFile });
  assert.deepEqual([text, opened.length, server.asked.length], ["complete", 2, 1]);
  assert.deepEqual(lost, ["no answer to a WebTransport session; and the file did not arrive in time"]);
  assert.ok(server.asked[0].signal.aborted);
});

test("a file that answers late is received if no session can be opened, or once the answer begins", async (context) => {
  const { advance } = stopClock(context);
  for (const [end, afterMs] of [
    [new NoWebTransport("no WebTransport"), 4500],
    [down(), 1],
  ] as const) {
    const late = async (asked: Asked): Promise<Response> => {
      await advance(afterMs);
      const { body, headers, status } = part(STILL, asked),
        slow = new TransformStream<Uint8Array, Uint8Array>({
          transform: async (piece, out) => {
            if (afterMs < 4500) await advance(4500);
            out.enqueue(piece);
          },
        });
      return new Response(body!.pipeThrough(slow), { headers, status });
    };
    new Server(late);
    const { ways, opened } = sessions(end),
      openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, firstBytes: 1 << 18, idleMs: 20_000 }),
      { text, lost } = await visit(null, { session: SESSION }, { ...ways, openFile });
    assert.deepEqual([text, opened.length, lost.length], ["complete", 1, 0]);
  }
});

test("after each failed session there is more time for the first answer of the file", async (context) => {
  const { advance } = stopClock(context);
  new Server(async (asked) => {
    await advance(5000, asked.signal);
    return part(STILL, asked);
  });
  const { ways, opened } = sessions(down(), down()),
    openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, firstBytes: 1 << 18, idleMs: 20_000 }),
    { text, lost } = await visit(null, { session: SESSION }, { ...ways, openFile });
  assert.deepEqual([text, opened.length, lost.length], ["complete", 2, 1]);
});

test("after a session that is too slow the rest comes by HTTP, also if it delivered packets", async () => {
  new Server((asked) => part(STILL, asked));
  let sessions = 0;
  const receiveDatagrams: Transports["receiveDatagrams"] = async (_session, _name, listener): Promise<string> => {
      const container = new ContainerReader(),
        packets = container.feed(STILL).map((bytes) => ({ order: UNKNOWN_ORDER, position: 0, bytes }));
      sessions++;
      listener.head(container.head!, container.headBytes, true, false);
      listener.packets(packets.slice(0, 2));
      return "the server sends too slowly";
    },
    { text, verified } = await visit(null, { session: SESSION }, { receiveDatagrams });
  assert.deepEqual([text, verified, sessions], ["complete", true, 1]);
});

test("a stream unknown to sessions and files fails without a retry", async () => {
  new Server(noFile);
  const { ways, opened } = sessions(new Error("no such stream")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.match(text, /404/);
  assert.deepEqual([opened.length, lost.length], [1, 0]);
});

test("without WebTransport a live clip fails at once with both reasons", async () => {
  new Server(noFile);
  const { ways } = sessions(new NoWebTransport("this browser or page has no WebTransport")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.match(text, /404.*no WebTransport/);
  assert.equal(lost.length, 0);
});

test("the server's session is looked up again if it has no file", async () => {
  new Server(noFile);
  const { ways, opened } = sessions("complete"),
    { text } = await visit(null, {}, { ...ways, lookUpSession: async () => SESSION });
  assert.equal(text, "complete");
  assert.deepEqual(opened, [SESSION]);
});

test("a session that delivers nothing is replaced by the file", async () => {
  new Server((asked) => part(STILL, asked));
  const { ways } = sessions(down()),
    { text, verified, said } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual([text, verified], ["complete", true]);
  assert.ok(said.some((one) => one.kind === "note" && /by HTTP: no answer/.test(one.text)));
});

test("a complete cached stream is revalidated over a session if there is no file", async () => {
  const caches = new Caches(),
    server = new Server((asked) => part(STILL, asked));
  await visit(caches);
  server.answering = noFile;
  const { ways, opened } = sessions("complete"),
    { text, lost } = await visit(caches, { session: SESSION }, ways);
  assert.deepEqual([text, opened.length, lost.length], ["complete", 1, 0]);
});

test("a file that is refused after it was read is requested again, a limited number of times", async () => {
  for (const [times, expected] of [
    [3, /^complete$/],
    [99, /404/],
  ] as const) {
    const server = new Server((asked, n) => (n > 0 && n <= times ? noFile() : part(STILL, asked))),
      { text } = await visit();
    assert.match(text, expected);
    assert.ok(server.asked.length < 20);
  }
});

test("refusals of a file are forgotten once packets arrive again", async () => {
  new Server((asked, n) => (n % 4 === 3 ? noFile() : part(LEVELS, asked)));
  const openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, firstBytes: 2500, tilesBytes: 300 }),
    { text, lost } = await visit(null, {}, { openFile });
  assert.equal(text, "complete");
  assert.ok(lost.length > 4);
});

test("a file that is replaced now and then is received for as long as the page is open", async () => {
  const versions = [LEVELS, otherStream(LEVELS)];
  for (const [changeMs, expected] of [
    [0, /^complete$/],
    [60_000, /replaced again and again/],
  ] as const) {
    let changes = 0;
    const server = new Server((asked, n) => part(versions[Math.min((changes += n % 4 === 3 ? 1 : 0), 6) % 2], asked)),
      openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, changeMs });
    assert.match((await visit(null, {}, { openFile })).text, expected);
    assert.ok(server.asked.length < 200);
  }
});

test("a live clip follows its server to another certificate and port after a restart", async () => {
  const published = { url: "https://scenes.example:4850/splatwire", fingerprint: "2b" },
    opened: SessionAddress[] = [],
    openings: SessionOptions[] = [];
  let lookUps = 0;
  new Server(noFile);
  const ways: Partial<Transports> = {
    receiveDatagrams: async (session, _name, listener: Listener, _before, opening): Promise<string> => {
      opened.push(session);
      openings.push(opening!);
      if (opened.length === 1) listener.head(readStream(CLIP).head, fileOf(CLIP), false, true);
      if (opened.length < 4) throw down();
      return "complete";
    },
    lookUpSession: async () => (++lookUps === 1 ? null : published), // it is down at first
  };
  const { text, lost } = await visit(null, { session: SIGNED }, ways);
  assert.equal(text, "complete");
  assert.deepEqual(opened, [SIGNED, SIGNED, published, published]);
  assert.equal(lost.length, 3);
  assert.deepEqual(openings[0], { isRetry: false, isOnlySource: false });
  for (const opening of openings.slice(1)) assert.deepEqual(opening, { isRetry: true, isOnlySource: true });
});

test("frames of a restarted live server are shown, which counts them from 0 again", async () => {
  new Server(noFile);
  const files = [fileOf(CLIP), otherStream(fileOf(CLIP))],
    { length } = files;
  let sessions = 0;
  const receiveDatagrams: Transports["receiveDatagrams"] = async (_session, _name, listener): Promise<string> => {
    const container = new ContainerReader(),
      packets = container.feed(files[sessions++]).map((bytes) => ({ order: UNKNOWN_ORDER, position: 0, bytes }));
    listener.head(container.head!, container.headBytes, false, true);
    listener.packets(packets);
    await (listener as WorkerReceiver).settled();
    if (sessions < length) throw new Error("the server fell silent");
    return "complete";
  };
  const { said } = await visit(null, { session: SESSION }, { receiveDatagrams }),
    kinds = said.flatMap((one) => (one.kind === "info" || one.kind === "playable" ? [one] : [])),
    ends = kinds.map((one) => (one.kind === "info" ? "begins" : one.end));
  assert.deepEqual(ends, ["begins", 4, 8, "begins", 4, 8]);
});

test("a still in place of a live clip is received over its session, and is complete", async () => {
  const server = new Server((asked) => part(STILL, asked));
  let sessions = 0;
  const receiveDatagrams: Transports["receiveDatagrams"] = async (_session, _name, listener): Promise<string> => {
    if (!sessions++) {
      listener.head(readStream(CLIP).head, fileOf(CLIP), false, true);
      throw new Error("the server fell silent");
    }
    const container = new ContainerReader(),
      packets = container.feed(STILL).map((bytes) => ({ order: UNKNOWN_ORDER, position: 0, bytes }));
    listener.head(container.head!, container.headBytes, true, false);
    listener.packets(packets);
    return "complete";
  };
  const { complete, verified, reception } = await visit(null, { session: SESSION }, { receiveDatagrams });
  assert.deepEqual([complete, verified, reception.live], [true, true, false]);
  assert.equal(server.asked.length, 0);
});

/** Sessions of a live clip, in turn: packets that arrive before a session breaks, null for one that does not open. */
function liveSessions(
  packets: readonly (readonly number[] | null)[],
): Partial<Transports> & { readonly opened: number[] } {
  const opened: number[] = [],
    container = new ContainerReader(),
    all = container.feed(fileOf(CLIP)).map((bytes) => ({ order: UNKNOWN_ORDER, position: 0, bytes }));
  const receiveDatagrams: Transports["receiveDatagrams"] = async (_session, _name, listener): Promise<string> => {
    const now = packets[opened.length];
    opened.push(opened.length);
    if (now === undefined) return "complete";
    if (!now) throw down();
    listener.head(container.head!, container.headBytes, false, true);
    listener.packets(now.map((n) => all[n]));
    throw new Error("the server fell silent");
  };
  return { receiveDatagrams, opened };
}

for (const [kind, file] of [
  ["a recording", otherStream(fileOf(CLIP))],
  ["a recording with the same id", fileOf(CLIP)],
  ["a still", STILL],
] as const)
  test(`${kind} in place of a live clip is received by HTTP if no session opens`, async () => {
    new Server((asked) => part(file, asked));
    const { opened, ...ways } = liveSessions([[0, 1], ...Array.from({ length: 20 }, () => null)]),
      { complete, verified, reception } = await visit(null, { session: SESSION }, ways);
    assert.deepEqual([complete, verified, reception.live], [true, true, false]);
    assert.equal(opened.length, 3);
  });

test("a live clip whose session breaks now and then stays live, although there is a file of its name", async () => {
  const server = new Server((asked) => part(STILL, asked)),
    { opened, ...ways } = liveSessions([[0], null, [1], null, [2], [3]]),
    { text, reception } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual([text, reception.live, opened.length, server.asked.length], ["complete", true, 7, 0]);
});

test("a live clip without a file waits for its session, and names both reasons", async () => {
  for (const answer of [noFile, () => Promise.reject(new TypeError("Failed to fetch")), () => new Response("<html>")]) {
    new Server(answer);
    const { opened, ...ways } = liveSessions([[0], null, null, null, [1]]),
      { text, lost } = await visit(null, { session: SESSION }, ways);
    assert.deepEqual([text, opened.length, lost.length], ["complete", 6, 5]);
    assert.match(lost[3], /no answer to a WebTransport session; and /);
  }
});

test("the next session of a live clip is due at its own time, although its file hangs", async (context) => {
  const server = hangingServer(stopClock(context)),
    { opened, ...ways } = liveSessions([[0], null, null, [1]]),
    openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, idleMs: 120_000 }),
    { text, lost, said } = await visit(null, { session: SESSION }, { ...ways, openFile }),
    delays = said.flatMap((one) => (one.kind === "disconnect" ? [one.retryMs] : []));
  assert.deepEqual([text, opened.length], ["complete", 5]);
  assert.deepEqual(delays, [500, 1000, 0, 500], "the file had the delay before the third retry");
  assert.match(lost[2], /no answer to a WebTransport session; and the file did not arrive in time/);
  assert.ok(server.asked.length === 1 && server.asked[0].signal.aborted);
});

test("the file in place of a live clip may take longer than the delay, once it has begun", async (context) => {
  const { advance } = stopClock(context);
  const slow = (): Response => {
    let sent = 0;
    const pull = async (controller: ReadableStreamDefaultController<Uint8Array>): Promise<void> => {
      await advance(sent ? 250 : 0);
      controller.enqueue(STILL.slice(sent, (sent += Math.ceil(STILL.length / 12))));
      if (sent >= STILL.length) controller.close();
    };
    return new Response(new ReadableStream<Uint8Array>({ pull }, { highWaterMark: 0 }), { status: 200 });
  };
  new Server(slow);
  const { opened, ...ways } = liveSessions([[0], null, null, null, null]),
    openFile = (url: string): HttpFile => new HttpFile(url, { ...LIMITS, idleMs: 10_000 }),
    { complete } = await visit(null, { session: SESSION }, { ...ways, openFile });
  assert.deepEqual([complete, opened.length], [true, 3]);
});

test("the backoff of a live clip begins again after packets have arrived", async () => {
  new Server(noFile);
  const { opened: _, ...ways } = liveSessions([[0], null, null, null, [1], [2]]),
    { said } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual(
    said.flatMap((one) => (one.kind === "disconnect" ? [one.retryMs] : [])),
    [500, 1000, 2000, 4000, 500, 500],
  );
});

test("few handshakes fail in one attempt, because each failure delays the next ones", async () => {
  const world = globalThis as Record<string, unknown>;
  let begun = 0;
  world["WebTransport"] = class {
    readonly ready = Promise.reject(new Error("Opening handshake failed."));
    readonly closed = Promise.reject(new Error("closed"));
    constructor() {
      begun++;
    }
    close(): void {}
  };
  try {
    const listener = {} as Listener;
    for (const [isRetry, most] of [
      [false, 2],
      [true, 1],
    ] as const) {
      begun = 0;
      const opening = { isRetry, isOnlySource: false };
      await assert.rejects(receiveDatagrams(SIGNED, "a", listener, null, opening), /handshake/);
      assert.equal(begun, most);
    }
  } finally {
    delete world["WebTransport"];
  }
});

test("sessions are closed, also if datagrams can no longer be sent, and after an error", async () => {
  const world = globalThis as Record<string, unknown>,
    random = crypto.getRandomValues;
  let numClosed = 0,
    said = 0;
  const stuck = (): Promise<void> => {
    said++;
    return new Promise(() => undefined);
  };
  world["WebTransport"] = class {
    readonly ready = Promise.resolve();
    readonly closed = new Promise(() => undefined);
    readonly datagrams = {
      incomingHighWaterMark: 1,
      readable: new ReadableStream({ start: (control) => control.enqueue(welcome()) }),
      writable: { getWriter: () => ({ write: stuck }) },
    };
    createBidirectionalStream(): Promise<unknown> {
      return Promise.resolve({ readable: new ReadableStream(), writable: new WritableStream() });
    }
    close(): void {
      numClosed++;
    }
  };
  crypto.getRandomValues = <T>(numbers: T): T => {
    (numbers as unknown as BigUint64Array)[0] = 7n; // the nonce of the welcome message
    return numbers;
  };
  try {
    let looks = 0;
    const listener = {
      preview: () => undefined,
      counts: () => undefined,
      stopped: () => ++looks > 5,
    } as unknown as Listener;
    const ended = receiveDatagrams(SESSION, "a", listener);
    const late = new Promise((done) => setTimeout(done, 10_000, "late").unref());
    assert.equal(await Promise.race([ended, late]), "stopped");
    assert.equal(numClosed, 1);
    assert.ok(said > 3);
    const counts = (): void => {
      throw new BitstreamError("the listener cannot read this stream");
    };
    await assert.rejects(receiveDatagrams(SESSION, "a", { ...listener, counts, stopped: () => false }), /cannot read/);
    assert.equal(numClosed, 2);
  } finally {
    delete world["WebTransport"];
    crypto.getRandomValues = random;
  }
});
