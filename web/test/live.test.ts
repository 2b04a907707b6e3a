// Jitter buffer of live clips: the delay follows the variation of arrival times, and no frame is due before it arrived.

import assert from "node:assert/strict";
import { test } from "node:test";

import { JitterBuffer } from "../src/jitter_buffer.ts";

const RATE = 30,
  GROUP = 15,
  STEP_S = 0.004;

/**
 * Plays groups that arrive `delays` seconds after their last frame, or never (`isLost`). Returns the time of each shown
 * frame.
 */
function played(
  delays: readonly number[],
  isLost = (_group: number): boolean => false,
): { buffer: JitterBuffer; shown: Map<number, number> } {
  const buffer = new JitterBuffer(RATE),
    shown = new Map<number, number>(),
    came = delays.map((delay, group) => ((group + 1) * GROUP) / RATE + delay),
    end = came[came.length - 1] + (2 * GROUP) / RATE;
  let next = 0;
  for (let now = 0; now < end; now += STEP_S) {
    for (; came[next] <= now; next++) if (!isLost(next)) buffer.add(0, (next + 1) * GROUP, now);
    const due = buffer.due(now);
    assert.ok(due === null || due < next * GROUP);
    if (due !== null && !shown.has(due)) shown.set(due, now);
  }
  return { buffer, shown };
}

test("with constant delays every frame is shown once without stalls", () => {
  const { buffer, shown } = played(Array.from({ length: 20 }, () => 0.05));
  assert.equal(shown.size, 20 * GROUP);
  const times = [...shown.values()],
    gaps = times.slice(1).map((time, n) => time - times[n]);
  assert.ok(Math.max(...gaps) < 1.5 / RATE);
  assert.ok(buffer.delaySeconds < 0.05);
});

test("playback does not stall once the buffer has adapted to varying delays", () => {
  const delays = Array.from({ length: 60 }, (_, n) => 0.05 + 0.15 * ((n * 7) % 5) * 0.25),
    { buffer, shown } = played(delays.slice(0, 12)),
    begun = buffer.stalledFrames;
  assert.equal(shown.size, 12 * GROUP);
  const longer = played(delays).buffer;
  assert.ok(longer.stalledFrames - begun <= GROUP + 1); // frames due after the last group
});

test("after a stall the clock catches up", () => {
  const delays = Array.from({ length: 120 }, (_, n) => (n === 20 ? 0.4 : 0.05)),
    { buffer, shown } = played(delays);
  assert.equal(shown.size, 120 * GROUP);
  assert.ok(buffer.delaySeconds < 0.1);
  assert.ok(shown.get(21 * GROUP)! > (21 * GROUP) / RATE + 0.4);
});

test("no stalls are counted while the player is not polled or after the end", () => {
  const buffer = new JitterBuffer(RATE);
  buffer.add(0, GROUP, 0);
  assert.equal(buffer.due(0.1), 2);
  buffer.add(GROUP, 10 * GROUP, 5); // the player was not polled for five seconds
  assert.equal(buffer.due(9.9), 10 * GROUP - 1);
  assert.ok(buffer.stalledFrames <= 5 * RATE);
  const { stalledFrames } = buffer;
  buffer.ended = true;
  assert.equal(buffer.due(60), 10 * GROUP - 1);
  assert.equal(buffer.stalledFrames, stalledFrames);
});

/** Delays of groups during an outage: all its groups arrive at its end. */
function outage(groups: number, begins: number, lasts: number): number[] {
  return Array.from({ length: groups }, (_, n) => {
    const encoded = ((n + 1) * GROUP) / RATE;
    return encoded < begins || encoded >= begins + lasts ? 0.05 : begins + lasts + 0.05 - encoded;
  });
}

for (const lasts of [3, 7, 20, 60])
  for (const isLost of [false, true])
    test(`playback is live again within two seconds after an outage of ${lasts} s, groups lost: ${isLost}`, () => {
      const begins = 15,
        groups = Math.ceil(((begins + lasts + 10) * RATE) / GROUP),
        delays = outage(groups, begins, lasts),
        { shown } = played(delays, (group) => isLost && delays[group] > 0.05);
      for (const [frame, time] of shown)
        if (time > begins + lasts + 2 + GROUP / RATE && frame < (groups - 1) * GROUP) {
          const behind = time - frame / RATE;
          assert.ok(behind < 2 * (GROUP / RATE) + 0.3, `frame ${frame} is ${behind} s behind`);
        }
      assert.ok(shown.has(groups * GROUP - 1));
    });

test("playback is live again within two seconds after each of several outages", () => {
  const lasts = 5,
    every = 100,
    groups = (6 * every * RATE) / GROUP,
    isOut = (group: number): boolean => (((group + 1) * GROUP) / RATE) % every >= every - lasts,
    { shown } = played(
      Array.from({ length: groups }, () => 0.05),
      isOut,
    );
  for (const [frame, time] of shown) {
    const behind = time - frame / RATE;
    if (time % every > 2 + GROUP / RATE && time % every < every - lasts)
      assert.ok(behind < 2 * (GROUP / RATE) + 0.3, `frame ${frame} is ${behind} s behind`);
  }
});

test("playback does not jump after each of many outages in a short time", () => {
  const lasts = 2,
    every = 10,
    begin = 100,
    isOut = (group: number): boolean => {
      const at = ((group + 1) * GROUP) / RATE;
      return at > begin && at % every >= every - lasts;
    },
    { buffer } = played(
      Array.from({ length: (400 * RATE) / GROUP }, () => 0.05),
      isOut,
    );
  assert.ok(buffer.stalledFrames < 10 * RATE, `${buffer.stalledFrames} frames`);
});

test("occasional late groups cause at most one stall", () => {
  const delays = Array.from({ length: 90 }, (_, n) => (n % 10 === 9 ? 1.5 : 0.05)),
    { shown } = played(delays);
  const times = [...shown.values()].slice(20 * GROUP),
    stops = times.slice(1).filter((time, n) => time - times[n] > 4 / RATE);
  assert.ok(stops.length <= 1, `${stops.length} stops`);
});
