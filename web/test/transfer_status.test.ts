// Errors and events of a transfer.

import assert from "node:assert/strict";
import { test } from "node:test";

import { newStatus } from "../src/page/events.ts";
import type { Panel } from "../src/page/panel.ts";
import { TransferStatus } from "../src/page/transfer_status.ts";

const DRAWING = "The scene cannot be drawn.";

/** Returns a transfer, its messages and the names of its events. */
function transfer(): { session: TransferStatus; messages: string[]; events: string[] } {
  const messages: string[] = [],
    events: string[] = [],
    panel = { setMessage: (text: string) => messages.push(text), showNotice: () => {} } as unknown as Panel;
  return { session: new TransferStatus(newStatus(), panel, (name) => events.push(name)), messages, events };
}

test("an error that is over is withdrawn", () => {
  const { session, messages } = transfer();
  session.fail(DRAWING);
  session.withdraw(DRAWING);
  assert.deepEqual([session.status.failed, messages.at(-1)], [null, ""]);
});

test("a wrong digest stays an error after a later drawing error is over", () => {
  const { session, messages } = transfer();
  session.finished("complete", true, false);
  session.verified(false);
  const digest = session.status.failed;
  assert.match(digest!, /digest is wrong/);
  for (let n = 0; n < 2; n++) {
    session.fail(DRAWING);
    session.fail(DRAWING);
    session.withdraw(DRAWING);
    assert.deepEqual([session.status.failed, messages.at(-1)], [digest, digest]);
  }
});

test("groups of frames that a slow device drops are named as long as the live clip plays", () => {
  const { session, messages } = transfer();
  Object.assign(session.status, { packets: 1, expected: 2, gaussians: 1 });
  for (const dropped of [0, 3]) session.progress(true, dropped);
  assert.deepEqual(messages, ["Live.", "Live. This device is too slow; dropped groups: 3."]);
});

test("a transfer that ends while nothing can be drawn is reported as loaded", () => {
  for (const [complete, live] of [
    [false, false],
    [true, true],
  ] as const) {
    const { session, messages, events } = transfer();
    session.fail(DRAWING);
    session.finished("sent", complete, live);
    assert.deepEqual([messages, events], [[DRAWING], ["error", "load"]]);
  }
});
