// The worker in a file of its own refuses pages of another build, whose messages it may not understand.

import assert from "node:assert/strict";
import { test } from "node:test";

import type { FromWorker, ToWorker } from "../src/transport/messages.ts";
import { fileOf } from "./vectors.ts";

type Listener = (event: { data: ToWorker }) => void;

test("a worker of another version than the page reports it, one of the same version opens the stream", async () => {
  const said: FromWorker[] = [],
    listeners: Listener[] = [];
  const world = {
    name: "another build",
    addEventListener: (kind: string, listener: Listener) => void (kind === "message" && listeners.push(listener)),
    postMessage: (message: FromWorker) => void said.push(message),
  };
  Object.assign(globalThis, { self: world, postMessage: world.postMessage });
  await import("../src/worker.ts");
  const bytes = fileOf("../tests/golden/tiny_causal.swz"),
    open = (): void => {
      for (const listener of listeners)
        listener({ data: { kind: "open", session: null, name: "", file: "", bytes: bytes.slice() } });
    };
  open();
  assert.equal(said.length, 1);
  assert.ok(said[0].kind === "failed" && said[0].text.includes("another version than the page"));
  world.name = BUILD;
  open();
  while (!said.slice(1).some(({ kind }) => kind === "digest" || kind === "failed"))
    await new Promise((resolve) => setImmediate(resolve));
  assert.deepEqual(
    said.filter(({ kind }) => kind === "digest"),
    [{ kind: "digest", isVerified: true }],
  );
});
