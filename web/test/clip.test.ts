// `splatwire/clip`: what a clip does with the messages of its worker.

import assert from "node:assert/strict";
import { getEventListeners } from "node:events";
import { type TestContext, test } from "node:test";

import { Clip, type ClipOptions } from "../src/clip.ts";
import { pack } from "../src/render/packed.ts";
import type { StreamInfo } from "../src/transport/messages.ts";
import { FakeWorker } from "./fake_worker.ts";

const RATE = 10,
  TIMING = { rate: RATE, numFrames: 20, live: false };

/** Properties of a stream of which a clip uses only these. */
const infoOf = (sequence: StreamInfo["sequence"], size = 3): StreamInfo =>
  ({ sequence, size, antialiased: false, concealers: ["motion", "hold"] }) as unknown as StreamInfo;

/** One Gaussian. */
const PACKED = { ...pack([], 0, 1), count: 1 };

/** Opens a clip, at time 0 of a clock that the test moves. */
async function opened(
  t: TestContext,
  sequence: StreamInfo["sequence"] = TIMING,
): Promise<[Clip, FakeWorker, (ms: number) => void]> {
  let now = 0;
  t.mock.method(performance, "now", () => now);
  const opening = Clip.open("https://scenes.example/a.swz");
  const worker = await workerOf(opening);
  worker.send({ kind: "info", info: infoOf(sequence) });
  const clip = await opening;
  t.after(() => clip.close());
  return [clip, worker, (ms) => (now = ms)];
}

/** Waits for the worker of a clip that is being opened. */
async function workerOf(opening: Promise<Clip>): Promise<FakeWorker> {
  opening.catch(() => undefined);
  FakeWorker.last = null;
  await new Promise((resolve) => setImmediate(resolve));
  return FakeWorker.last!;
}

/** Sends a frame. */
const frame = (worker: FakeWorker, number: number, antialiased = false): void =>
  worker.send({ kind: "frame", number, packed: PACKED, antialiased, numConcealed: 0, numKept: 0, frameMs: 0 });

/** Names of events, in order. */
function heard(clip: Clip): string[] {
  const names: string[] = [];
  for (const name of ["ended", "lost", "error"])
    clip.addEventListener(name, (event) => names.push(`${name} ${(event as CustomEvent).detail ?? ""}`.trim()));
  return names;
}

test("a frame is requested when it is due, one at a time", async (t) => {
  const [clip, worker, at] = await opened(t);
  assert.equal(clip.update(), null);
  frame(worker, 0);
  clip.play();
  assert.equal(clip.update()?.number, 0);
  at(250);
  clip.update();
  at(450);
  assert.equal(clip.update(), null);
  frame(worker, 2);
  assert.equal(clip.update()?.number, 2);
  assert.deepEqual(
    worker.requests.flatMap((one) => (one.kind === "frame" ? [one.number] : [])),
    [0, 2, 4],
  );
});

test("a clip ends once, also if it is paused after its last frame and before the next picture", async (t) => {
  for (const end of [(clip: Clip) => void clip.update(), (clip: Clip) => clip.pause()]) {
    const [clip, worker, at] = await opened(t),
      events = heard(clip);
    clip.update();
    frame(worker, 0);
    clip.play();
    at(5000);
    assert.equal(clip.currentTime, 1.9);
    end(clip);
    clip.update();
    assert.deepEqual(events, ["ended"]);
    assert.deepEqual([clip.ended, clip.paused], [true, true]);
    clip.play();
    assert.deepEqual([clip.ended, clip.paused, clip.currentTime], [false, false, 0]);
    t.mock.restoreAll();
  }
});

test("a clip ends although no frames are taken, as in a hidden page", async (t) => {
  t.mock.timers.enable({ apis: ["setInterval"] });
  for (const [sequence, expected] of [
    [TIMING, ["ended"]],
    [{ ...TIMING, live: true }, ["ended"]],
  ] as const) {
    const [clip, worker, at] = await opened(t, sequence),
      events = heard(clip);
    worker.send({ kind: "playable", begin: 0, end: 20, late: 0 });
    clip.update();
    frame(worker, 0);
    clip.play();
    worker.send({ kind: "finished", outcome: "complete", complete: true });
    for (const [ms, some] of [
      [1000, []],
      [5000, expected],
      [9000, expected],
    ] as const) {
      at(ms);
      t.mock.timers.tick(1000);
      assert.deepEqual(events, some);
      assert.equal(clip.paused, some.length > 0);
    }
  }
});

test("a clip that is played after its last frame has ended before, and a closed one does not end", async (t) => {
  for (const [use, expected] of [
    [(clip: Clip) => clip.play(), ["ended"]],
    [(clip: Clip) => clip.close(), []],
  ] as const) {
    const [clip, worker, at] = await opened(t),
      events = heard(clip);
    clip.update();
    frame(worker, 0);
    clip.play();
    at(5000);
    assert.equal(clip.currentTime, 1.9);
    use(clip);
    clip.update();
    assert.deepEqual(events, expected);
    assert.deepEqual([clip.paused, worker.isTerminated], [!expected.length, !expected.length]);
    t.mock.restoreAll();
  }
});

test("a replaced file is an error, because its frames have another size and rate", async (t) => {
  const [clip, worker] = await opened(t),
    events = heard(clip);
  clip.update(); // a frame that is not answered any more
  worker.send({ kind: "info", info: infoOf({ ...TIMING, rate: 30 }, 80) });
  assert.deepEqual(events, ["error the file was replaced: open it again"]);
  assert.deepEqual([worker.isTerminated, clip.size, clip.rate], [true, 3, RATE]);
});

test("a closed clip and one whose worker failed stop their timer and do not play again", async (t) => {
  const stopped = t.mock.method(globalThis, "clearInterval"),
    started = t.mock.method(globalThis, "setInterval");
  for (const [stop, expected] of [
    [(clip: Clip) => clip.close(), []],
    [
      (_: Clip, worker: FakeWorker) =>
        worker.dispatchEvent(Object.assign(new Event("error"), { message: "no memory" })),
      ["error no memory"],
    ],
  ] as const) {
    const [clip, worker] = await opened(t),
      events = heard(clip);
    clip.loop = true;
    clip.play();
    const timer = started.mock.calls.at(-1)!.result,
      count = started.mock.callCount();
    stop(clip, worker);
    clip.play();
    assert.equal(started.mock.callCount(), count);
    assert.ok(stopped.mock.calls.some(({ arguments: [one] }) => one === timer));
    assert.deepEqual([clip.paused, worker.isTerminated, events], [true, true, expected]);
  }
});

test("frames of a live clip may become antialiased", async (t) => {
  const [clip, worker, at] = await opened(t, { ...TIMING, live: true });
  worker.send({ kind: "playable", begin: 0, end: 5, late: 0 });
  at(500);
  assert.equal(clip.update(), null);
  frame(worker, 0, true);
  assert.equal(clip.antialiased, true);
});

test("opening fails for stills, unknown concealers, failures and aborted signals", async () => {
  const cases: [ClipOptions, (worker: FakeWorker, stop: AbortController) => void, RegExp][] = [
    [{}, (worker) => worker.send({ kind: "info", info: infoOf(null) }), /not a clip/],
    [{ concealer: "grow" }, (worker) => worker.send({ kind: "info", info: infoOf(TIMING) }), /no concealer 'grow'/],
    [{}, (worker) => worker.send({ kind: "failed", text: "there is no such file" }), /no such file/],
    [{}, (worker) => worker.dispatchEvent(Object.assign(new Event("error"), { message: "no memory" })), /no memory/],
    [{}, (_, stop) => stop.abort(new Error("too slow")), /too slow/],
  ];
  for (const [options, fail, reason] of cases) {
    const stop = new AbortController(),
      opening = Clip.open("https://scenes.example/a.swz", { signal: stop.signal, ...options }),
      worker = await workerOf(opening);
    worker.send({ kind: "disconnect", reason: "unreachable", retryMs: 500 });
    fail(worker, stop);
    await assert.rejects(opening, reason);
    assert.equal(worker.isTerminated, true);
    assert.deepEqual(getEventListeners(stop.signal, "abort"), []);
  }
});

test("a signal that is aborted before the worker starts prevents it", async () => {
  FakeWorker.last = null;
  const stop = new AbortController(),
    opening = Clip.open("https://scenes.example/a.swz", { signal: stop.signal });
  stop.abort();
  await assert.rejects(opening, /aborted/);
  await assert.rejects(Clip.open("https://scenes.example/a.swz", { signal: stop.signal }), /aborted/);
  assert.equal(FakeWorker.last, null);
});
