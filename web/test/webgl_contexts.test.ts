// WebGL contexts go to visible elements.

import assert from "node:assert/strict";
import { test } from "node:test";

import { acquireContext, offerContext, releaseContext } from "../src/render/webgl_contexts.ts";

class Owner {
  isVisible = true;
  has = false;

  open(): void {
    this.has = this.isVisible && acquireContext(this);
  }

  release(): void {
    this.has = false;
  }

  onContextAvailable(): void {
    this.open();
  }
}

test("a context that becomes free goes to the first visible element that waits", () => {
  const owners = Array.from({ length: 11 }, () => new Owner());
  for (const owner of owners) owner.open();
  assert.deepEqual(
    owners.map(({ has }) => has),
    owners.map((_, n) => n < 8),
  );
  const [first] = owners,
    [hidden, waiting, last] = owners.slice(8);
  hidden.isVisible = first.isVisible = false;
  offerContext();
  assert.deepEqual([first.has, hidden.has, waiting.has, last.has], [false, false, true, false]);
  hidden.isVisible = true;
  hidden.open();
  releaseContext(owners[1]);
  assert.deepEqual([hidden.has, last.has], [true, false]);
  for (const owner of owners) releaseContext(owner);
});

test("a context that was offered to an owner that leaves goes to the next one", () => {
  const owners = Array.from({ length: 8 }, () => new Owner()),
    [leaving, next] = [new Owner(), new Owner()];
  leaving.onContextAvailable = () => undefined; // it still loads the renderer
  for (const owner of [...owners, leaving, next]) owner.open();
  releaseContext(owners[0]);
  assert.equal(next.has, false);
  releaseContext(leaving);
  assert.equal(next.has, true);
  for (const owner of [...owners, next]) releaseContext(owner);
});
