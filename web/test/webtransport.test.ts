import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { crc32 } from "../src/packets/crc32.ts";
import type { Listener } from "../src/transport/events.ts";
import { receiveDatagrams } from "../src/transport/webtransport.ts";
import { END, INIT_SYMBOL, LIVE, NOT_YET, REFUSE, VERSION } from "../src/transport/wire.ts";
import { dataView } from "../src/transport/wire_messages.ts";
import { empty, welcome } from "./wire_messages.ts";

/** Time between two steps of the fake clock, milliseconds. */
const STEP_MS = 50;
/** Time until the listener ends a session, milliseconds. */
const STOP_MS = 60_000;

/** Datagrams that a server sends at time `ms` of a session with a nonce. */
type Sending = (ms: number, nonce: bigint) => Uint8Array[];

/** Message of the session of `welcome`, with a checksum. */
function message(kind: number, size: number, fill: (numbers: DataView) => void): Uint8Array {
  const bytes = new Uint8Array(size);
  bytes[0] = (VERSION << 4) | kind;
  fill(dataView(bytes));
  dataView(bytes).setUint32(size - 4, crc32(bytes.subarray(0, -4)), true);
  return bytes;
}

/** Returns how a session with a fake server ends, and its duration in milliseconds of a fake clock. */
async function endOf(sending: Sending, name = "a"): Promise<[string, number]> {
  const world = globalThis as Record<string, unknown>;
  let now = 0,
    nonce: bigint | null = null,
    ended: string | null = null,
    source: ReadableStreamDefaultController<Uint8Array>;
  const written = new WritableStream<Uint8Array>({
      write: (bytes) => {
        nonce ??= dataView(bytes).getBigUint64(1, true);
      },
    }),
    ignored = new WritableStream<Uint8Array>();
  world["WebTransport"] = class {
    readonly ready = Promise.resolve();
    readonly closed = new Promise(() => undefined);
    readonly datagrams = {
      readable: new ReadableStream<Uint8Array>({ start: (controller) => void (source = controller) }),
      writable: written,
    };
    createBidirectionalStream = (): Promise<unknown> =>
      Promise.resolve({ readable: new ReadableStream<Uint8Array>(), writable: ignored });
    close(): void {}
  };
  mock.timers.enable({ apis: ["setTimeout"] });
  const clock = mock.method(performance, "now", () => now),
    listener = {
      stopped: () => now >= STOP_MS,
      preview: () => undefined,
      counts: () => undefined,
    } as unknown as Listener;
  try {
    receiveDatagrams({ url: "https://scenes.example/" }, name, listener, null, { isRetry: true, isOnlySource: false })
      .then((outcome) => (ended = outcome))
      .catch((error: unknown) => (ended = (error as Error).message));
    for (; ended === null && now < 2 * STOP_MS; now += STEP_MS) {
      if (nonce !== null) for (const bytes of sending(now, nonce)) source!.enqueue(bytes);
      await new Promise((resolve) => setImmediate(resolve));
      mock.timers.tick(STEP_MS);
      await new Promise((resolve) => setImmediate(resolve));
    }
    return [ended ?? "never", now];
  } finally {
    clock.mock.restore();
    mock.timers.reset();
    delete world["WebTransport"];
  }
}

const greeting = (nonce: bigint, streamId = 3, flags = 0, initSegmentBytes = 400): Uint8Array =>
    welcome((numbers, bytes) => {
      numbers.setBigUint64(1, nonce, true);
      numbers.setUint32(13, streamId, true);
      numbers.setBigUint64(17, BigInt(initSegmentBytes), true);
      numbers.setUint32(59, 1000, true);
      bytes[69] = flags;
    }),
  end = (sequence: number): Uint8Array => message(END, 13, (numbers) => numbers.setUint32(5, sequence, true));

const FRUITLESS: Record<string, Sending> = {
  "a silent server": () => [],
  garbage: () => [new Uint8Array(900)],
  "a repeated welcome message": (_, nonce) => [greeting(nonce)],
  "the end of a stream without side information": (ms, nonce) => [greeting(nonce), end(ms / STEP_MS)],
  "a repeated packet": (_, nonce) => [greeting(nonce), empty(3)],
  "periods without a head": (ms, nonce) => [greeting(nonce, ms + 3, LIVE, 400 + ms)],
};
for (const [name, sending] of Object.entries(FRUITLESS))
  test(`a session ends after ten seconds without anything new: ${name}`, async () => {
    const [reason, ms] = await endOf(sending);
    assert.equal(reason, "the server sends nothing new");
    assert.ok(ms >= 10_000 && ms < 11_000, `${ms} ms`);
  });

test("no session is opened for a name that no request can contain", async () => {
  for (const name of ["é".repeat(33), "a\nb", "a\u00a0b", "a\u200db", "\u202eb", "a\u2028", "a\u3000b", "\ue000"]) {
    const [reason, ms] = await endOf(() => [], name);
    assert.equal(reason, "the name of the stream has more than 64 bytes, or is not printable", JSON.stringify(name));
    assert.ok(ms < 1000, `${ms} ms`);
  }
  for (const name of ["é".repeat(32), "a b", "सदन 🚀 1'(2)"]) {
    const [reason] = await endOf(() => [], name);
    assert.equal(reason, "the server sends nothing new", name);
  }
});

/** Symbol of the side information in `greeting`, each of 256 bytes. */
const symbol = (index: number): Uint8Array =>
  message(INIT_SYMBOL, 15 + 256 + 4, (numbers) => {
    numbers.setUint32(1, 2, true);
    numbers.setUint32(11, index, true);
  });

const SLOW: Record<string, Sending> = {
  "one symbol each five seconds": (ms, nonce) => (ms % 5000 ? [] : [greeting(nonce, 3, 0, 1 << 20), symbol(ms / 5000)]),
  "one symbol of a live stream each five seconds": (ms, nonce) =>
    ms % 5000 ? [] : [greeting(nonce, 3, LIVE, 1 << 20), symbol(ms / 5000)],
  "one packet each nine seconds": (ms, nonce) => (ms % 9000 ? [] : [greeting(nonce), empty(ms / 9000)]),
};
for (const [name, sending] of Object.entries(SLOW))
  test(`a session ends after thirty seconds with fewer than eight new symbols or packets: ${name}`, async () => {
    const [reason, ms] = await endOf(sending);
    assert.equal(reason, "the server sends too slowly");
    assert.ok(ms >= 30_000 && ms < 36_000, `${ms} ms`);
  });

const USEFUL: Record<string, Sending> = {
  "one symbol each three seconds": (ms, nonce) =>
    ms % 3000 ? [] : [greeting(nonce, 3, 0, 1 << 20), symbol(ms / 3000)],
  "a live stream that has not begun": (_, nonce) => [
    message(REFUSE, 14, (numbers) => {
      numbers.setBigUint64(1, nonce, true);
      numbers.setUint8(9, NOT_YET);
    }),
  ],
};
for (const [name, sending] of Object.entries(USEFUL))
  test(`a session goes on as long as something new arrives: ${name}`, async () => {
    const [, ms] = await endOf(sending);
    assert.ok(ms >= STOP_MS && ms < STOP_MS + 1000, `${ms} ms`);
  });

/** Returns the URLs of the sessions that are tried for an address that refuses all, or is silent. */
async function triedFor(url: string, isSilent = false): Promise<string[]> {
  const world = globalThis as Record<string, unknown>,
    tried: string[] = [];
  world["WebTransport"] = class {
    readonly ready = isSilent ? new Promise(() => undefined) : Promise.reject(new Error("refused"));
    readonly closed = new Promise(() => undefined);
    constructor(address: string) {
      tried.push(address);
    }
    close(): void {}
  };
  mock.timers.enable({ apis: ["setTimeout"] });
  let ended = "";
  try {
    receiveDatagrams({ url }, "a", {} as Listener, null, { isRetry: true, isOnlySource: false }).catch(
      (error: unknown) => (ended = (error as Error).message),
    );
    while (!ended) {
      await new Promise((resolve) => setImmediate(resolve));
      mock.timers.tick(STEP_MS);
    }
    assert.equal(ended, isSilent ? "no answer to a WebTransport session" : "refused");
    return tried;
  } finally {
    mock.timers.reset();
    delete world["WebTransport"];
  }
}

test("sessions with localhost are tried at 127.0.0.1 first", async () => {
  for (const host of ["localhost", "LOCALHOST.", "scenes.localhost"]) {
    const url = new URL(`https://${host}:4840/splatwire`).href;
    assert.deepEqual(await triedFor(url), ["https://127.0.0.1:4840/splatwire", url]);
    assert.deepEqual(await triedFor(url, true), ["https://127.0.0.1:4840/splatwire"], "else the file comes later");
  }
  for (const url of ["https://notlocalhost:4840/a", "https://localhost.example/a", "https://127.0.0.1:4840/a"])
    assert.deepEqual(await triedFor(url), [url]);
});

/** Installs a class `WebTransport` that opens sessions with the hosts for which a function returns true. */
function install(isOpenAt: (host: string) => boolean): void {
  (globalThis as Record<string, unknown>)["WebTransport"] = class {
    readonly ready: Promise<void>;
    readonly closed = new Promise(() => undefined);
    readonly datagrams = {};
    constructor(address: string) {
      this.ready = isOpenAt(new URL(address).hostname) ? Promise.resolve() : Promise.reject(new Error("refused"));
    }
    createBidirectionalStream = (): Promise<never> => Promise.reject(new Error("open"));
    close(): void {}
  };
}

test("after a session with localhost was open, failed handshakes are not repeated at the other address", async () => {
  const world = globalThis as Record<string, unknown>,
    url = "https://localhost:4841/splatwire",
    options = { isRetry: true, isOnlySource: true };
  for (const answering of ["127.0.0.1", "localhost"]) {
    const tried: string[] = [];
    let isUp = true;
    install((host) => {
      tried.push(host);
      return isUp && host === answering;
    });
    const session = { url: `${url}/${answering}` },
      attempt = (): Promise<unknown> =>
        receiveDatagrams(session, "a", {} as Listener, null, options).catch(
          (error: unknown) => (error as Error).message,
        );
    try {
      assert.equal(await attempt(), "open");
      tried.length = 0;
      isUp = false;
      assert.equal(await attempt(), "refused");
      assert.deepEqual(tried, [answering]);
    } finally {
      delete world["WebTransport"];
    }
  }
});

test("a server that returns at the other address of localhost is found", async () => {
  const world = globalThis as Record<string, unknown>,
    options = { isRetry: true, isOnlySource: true };
  for (const [before, after] of [
    ["127.0.0.1", "localhost"],
    ["localhost", "127.0.0.1"],
  ])
    for (const isRenewed of [false, true]) {
      let answering = before;
      install((host) => host === answering);
      const url = `https://localhost:4842/splatwire/${before}/${isRenewed}`,
        attempt = (fingerprint: string): Promise<unknown> =>
          receiveDatagrams({ url, fingerprint }, "a", {} as Listener, null, options).catch(
            (error: unknown) => (error as Error).message,
          );
      try {
        assert.equal(await attempt("00"), "open");
        answering = after;
        const outcomes: unknown[] = [];
        for (let n = 0; n < 5; n++) outcomes.push(await attempt(isRenewed ? "01" : "00"));
        const failed = isRenewed ? 0 : 3; // a server with another certificate was restarted
        assert.deepEqual(outcomes, [...Array(failed).fill("refused"), ...Array(5 - failed).fill("open")]);
      } finally {
        delete world["WebTransport"];
      }
    }
});

test("a handshake that the browser delays by 90 s is waited for if there is no other source", async () => {
  const world = globalThis as Record<string, unknown>;
  for (const isOnlySource of [false, true]) {
    let numTried = 0,
      ended = "";
    world["WebTransport"] = class {
      readonly ready = new Promise<void>((resolve) => setTimeout(resolve, 90_000));
      readonly closed = new Promise(() => undefined);
      readonly datagrams = {};
      constructor() {
        numTried++;
      }
      createBidirectionalStream = (): Promise<never> => Promise.reject(new Error("open"));
      close(): void {}
    };
    mock.timers.enable({ apis: ["setTimeout"] });
    try {
      receiveDatagrams({ url: "https://scenes.example/" }, "a", {} as Listener, null, {
        isRetry: true,
        isOnlySource,
      }).catch((error: unknown) => (ended = (error as Error).message));
      while (!ended) {
        await new Promise((resolve) => setImmediate(resolve));
        mock.timers.tick(1000);
      }
      assert.deepEqual([ended, numTried], [isOnlySource ? "open" : "no answer to a WebTransport session", 1]);
    } finally {
      mock.timers.reset();
      delete world["WebTransport"];
    }
  }
});
