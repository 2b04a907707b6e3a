// Clocks of clips: seeking, looping, the end, and the wait for the first picture; pauses and the end of live clips.

import assert from "node:assert/strict";
import test from "node:test";

import { ClipClock, LiveClock } from "../src/frame_clock.ts";

const timing = { rate: 30, numFrames: 45 };

/** A clock whose first frame is on the screen at time 0. */
function started(): ClipClock {
  const clock = new ClipClock(timing);
  clock.start(0);
  return clock;
}

test("a seek to the time of a frame shows this frame", () => {
  const clock = started();
  for (let frame = 0; frame < timing.numFrames; frame++) {
    clock.seek(frame / timing.rate);
    assert.equal(clock.due(100, false), frame);
    assert.equal(clock.ended, false);
  }
  for (const [seconds, frame] of [
    [-1, 0],
    [Infinity, 44],
  ]) {
    clock.seek(seconds);
    assert.equal(clock.due(100, false), frame);
  }
});

test("frames follow the time, and a pause keeps the frame", () => {
  const clock = started();
  clock.play(10);
  assert.equal(clock.due(10.51, false), 15);
  clock.pause(10.51);
  assert.equal(clock.due(99, false), 15);
  clock.play(200);
  assert.equal(clock.due(200.5, false), 30);
});

test("a pause in a later lap of a loop keeps the frame", () => {
  const clock = started();
  clock.play(0);
  assert.equal(clock.due(1.6, true), 3);
  clock.pause(1.61);
  assert.equal(clock.due(99, true), 3);
  assert.equal(clock.ended, false);
});

test("a clip ends at its last frame or continues with the first one", () => {
  const clock = started();
  clock.play(0);
  assert.equal(clock.due(1.6, true), 3);
  assert.equal(clock.ended, false);
  assert.equal(clock.due(3, false), 44);
  assert.equal(clock.ended, true);
  clock.play(4);
  assert.equal(clock.due(4, false), 44);
  clock.seek(0);
  assert.equal(clock.ended, false);
  assert.equal(clock.due(5, false), 0);
});

test("the clock stands still until the first picture", () => {
  const clock = new ClipClock(timing);
  clock.play(0);
  assert.equal(clock.due(2, false), 0);
  clock.start(2);
  clock.start(3);
  assert.equal(clock.due(2.51, false), 15);
});

/** Number of frames of a group, and frames per second, of the live clips. */
const GROUP = 5,
  RATE = 10;

/** Announces the groups of a live clip that have arrived at a time, half a second after each other from `began` on. */
function arrive(clock: LiveClock, now: number, first = 0, began = 0): void {
  const groups = Math.floor((now - began) / (GROUP / RATE)) + 1;
  if (groups > 0) clock.playable(first, first + groups * GROUP, now);
}

test("a live clip shows each frame once it is due, and never goes back", () => {
  const clock = new LiveClock(RATE);
  clock.play();
  assert.equal(clock.due(0), null);
  let last = -1;
  for (let tick = 0; tick < 100; tick++) {
    arrive(clock, tick / 20);
    const due = clock.due(tick / 20) ?? -1;
    assert.ok(due === last || due === last + 1, `frame ${due} after ${last}`);
    last = due;
  }
  assert.ok(last >= 48 && last < 50, `frame ${last} after 5 seconds`);
  assert.equal(clock.ended, false);
});

test("a visitor who joins late sees no frame before the first group that arrived", () => {
  const clock = new LiveClock(RATE);
  clock.play();
  for (let tick = 0; tick < 40; tick++) {
    arrive(clock, 60 + tick / 20, 600, 60);
    const due = clock.due(60 + tick / 20);
    assert.ok(due === null || due >= 600);
  }
});

test("a paused live clip keeps its frame, continues at the live position, and has no other time", () => {
  const clock = new LiveClock(RATE);
  clock.play();
  for (let now = 0; now <= 2; now += 0.05) {
    arrive(clock, now);
    clock.due(now);
  }
  const kept = clock.due(2)!;
  clock.pause();
  for (let now = 2; now <= 6; now += 0.05) {
    arrive(clock, now);
    assert.equal(clock.due(now), kept);
  }
  clock.seek();
  assert.equal(clock.due(6), kept);
  clock.play();
  assert.ok(clock.due(6)! > kept + 3 * RATE);
});

test("a live clip that is paused from the start shows one frame", () => {
  const clock = new LiveClock(RATE);
  arrive(clock, 0);
  assert.equal(clock.due(0.2), 1);
  arrive(clock, 3);
  assert.equal(clock.due(3), 1);
});

test("a live clip ends after its last frame, also after a pause, and if there never was a frame", () => {
  const clock = new LiveClock(RATE);
  clock.play();
  arrive(clock, 0);
  clock.end();
  assert.equal(clock.due(0.2), 1);
  assert.equal(clock.ended, false);
  clock.pause();
  assert.deepEqual([clock.due(20), clock.ended], [1, false]);
  clock.play();
  assert.deepEqual([clock.due(20), clock.ended], [GROUP - 1, true]);
  const empty = new LiveClock(RATE);
  empty.end();
  assert.deepEqual([empty.due(1), empty.ended], [null, true]);
});
