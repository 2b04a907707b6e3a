// Playback of the page before a stream arrives: what was requested holds for clips, live clips and stills.

import assert from "node:assert/strict";
import { mock, test } from "node:test";

import type { Panel } from "../src/page/panel.ts";
import { SequencePlayback } from "../src/page/sequence_playback.ts";

/** Any element of the page, and the page itself. Every property is a function that returns such an element. */
const anything: object = new Proxy(() => anything, { get: () => anything });
Object.assign(globalThis, {
  document: anything,
  window: globalThis,
  /** The visitor prefers reduced motion, so nothing plays by itself. */
  matchMedia: () => ({ matches: true }),
});

const CLIP = { rate: 10, numFrames: 20, live: false },
  LIVE = { rate: 10, numFrames: 3, live: true };

const playback = (): SequencePlayback =>
  new SequencePlayback(
    () => anything as unknown as Panel,
    () => undefined,
    {},
  );

test("before a stream arrives, the last request decides whether it is paused", () => {
  const early = playback();
  assert.equal(early.paused, true);
  early.play(true);
  assert.equal(early.paused, false);
  early.seek(1.5);
  assert.deepEqual([early.paused, early.currentTime], [true, 1.5]);
  early.play(true);
  assert.deepEqual([early.paused, early.currentTime], [false, 1.5]);
  early.play(false);
  assert.equal(early.paused, true);
  early.seek(-1);
  assert.equal(early.currentTime, 0);
});

test("a seek pauses a clip that arrives later, but not a live clip", () => {
  for (const [sequence, paused, time] of [
    [CLIP, true, 1.5],
    [LIVE, false, 0],
  ] as const) {
    const early = playback();
    early.play(true);
    early.seek(1.5);
    early.begin(sequence, true);
    assert.deepEqual([early.paused, early.currentTime], [paused, time]);
    early.destroy();
  }
});

test("a still takes no request along to the clip that replaces it", () => {
  const early = playback();
  early.play(true);
  early.seek(1);
  early.begin(null, true);
  assert.deepEqual([early.paused, early.currentTime], [true, 0]);
  early.begin(CLIP, true);
  assert.deepEqual([early.paused, early.currentTime], [true, 0]);
  early.destroy();
});

test("a player that is removed while a frame is drawn does not go on when the frame is announced", () => {
  let now = 0;
  mock.method(performance, "now", () => now);
  mock.timers.enable({ apis: ["setTimeout"] });
  for (const [end, expected] of [
    [() => undefined, [0, 10]],
    [(playing: SequencePlayback) => playing.destroy(), [0]],
  ] as const) {
    const requests: number[] = [],
      playing = new SequencePlayback(
        () => anything as unknown as Panel,
        (number) => requests.push(number),
        { playing: true },
      );
    now = 0;
    playing.begin(CLIP, true);
    end(playing);
    playing.shown(0);
    now = 1000;
    mock.timers.tick(1000);
    assert.deepEqual(requests, expected);
    playing.destroy();
  }
  mock.timers.reset();
  mock.restoreAll();
});
