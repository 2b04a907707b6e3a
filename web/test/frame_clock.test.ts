// Clock of clips: seeking, looping, the end, and the wait for the first picture.

import assert from "node:assert/strict";
import test from "node:test";

import { ClipClock } from "../src/frame_clock.ts";

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
