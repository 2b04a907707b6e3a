// Comparison of pictures: no PSNR of a former setting is reported after another one was chosen.

import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { Comparison } from "../src/page/comparison.ts";
import type { Stage } from "../src/page/stage.ts";

/** More than the time without changes after which pictures are compared, milliseconds. */
const REST_MS = 1000;
const LOST = Float32Array.of(1, 0),
  LOST_LATER = Float32Array.of(0, 0);

/** Gives canvases whose pictures have one pixel of a brightness. */
function fakePage(brightness: () => number): void {
  const data = Uint8ClampedArray.of(0, 0, 0, 255),
    context = {
      drawImage: () => data.fill(brightness(), 0, 3),
      getImageData: () => ({ width: 1, height: 1, data: data.slice() }),
      putImageData: () => undefined,
    };
  class FakeCanvas {
    readonly classList = { remove: () => undefined, toggle: () => undefined };
    readonly width = 1;
    readonly height = 1;
    readonly getContext = (): unknown => context;
    readonly setAttribute = (): void => undefined;
    readonly append = (): void => undefined;
  }
  class FakeImageData {
    readonly data = new Uint8ClampedArray(4);
  }
  Object.assign(globalThis, {
    window: globalThis,
    document: { createElement: () => new FakeCanvas() },
    OffscreenCanvas: FakeCanvas,
    ImageData: FakeImageData,
  });
}

/** Begins a comparison and returns it, its reports, and functions that wait for its frames and let them go on. */
function begin(): {
  comparison: Comparison;
  reports: (string | null)[];
  rest: () => Promise<void>;
  hold: () => () => void;
} {
  let gains: Float32Array | null = null,
    gate: Promise<void> = Promise.resolve();
  fakePage(() => (gains ? 100 : 200));
  const renderer = {
      canvas: { width: 1, height: 1 },
      replacementSorted: () => Promise.resolve(),
      frame: () => gate,
      setGains: (given: Float32Array | null) => Promise.resolve(void (gains = given)),
    },
    stage = { renderer, withRenderer: (work: (given: unknown) => void) => work(renderer) },
    reports: (string | null)[] = [],
    comparison = new Comparison(
      stage as unknown as Stage,
      () => "received",
      (psnr) => void reports.push(psnr),
    );
  const rest = async (): Promise<void> => {
    mock.timers.tick(REST_MS);
    for (let n = 0; n < 9; n++) await new Promise((resolve) => setImmediate(resolve));
  };
  const hold = (): (() => void) => {
    const { promise, resolve } = withResolvers();
    gate = promise;
    return resolve;
  };
  comparison.show(LOST, null);
  return { comparison, reports, rest, hold };
}

function withResolvers(): { promise: Promise<void>; resolve: () => void } {
  let resolve = (): void => undefined;
  const promise = new Promise<void>((done) => (resolve = done));
  return { promise, resolve };
}

test.beforeEach(() => mock.timers.enable({ apis: ["setTimeout"] }));
test.afterEach(() => mock.timers.reset());

test("pictures are compared once they rest", async () => {
  const { reports, rest } = begin();
  assert.deepEqual(reports, ["comparing ..."]);
  await rest();
  assert.deepEqual(reports, ["comparing ...", "8.1 dB"]);
});

for (const state of ["waits", "runs"])
  test(`a comparison that ${state} ends if the setting changes again`, async () => {
    const { comparison, reports, rest, hold } = begin(),
      go = hold();
    if (state === "runs") await rest();
    comparison.awaitGains();
    go();
    await rest();
    comparison.pictureChanged(); // the camera moves
    await rest();
    assert.ok(
      reports.every((report) => report === "comparing ..."),
      reports.join(),
    );
    comparison.show(LOST_LATER, null);
    await rest();
    assert.equal(reports.at(-1), "8.1 dB");
  });
