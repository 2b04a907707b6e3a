// Files of updates: whole, missing, refused, or larger than declared.

import assert from "node:assert/strict";
import { afterEach, mock, test } from "node:test";

import { HttpError } from "../src/transport/http_error.ts";
import { fileManifest, manifestDigest, readWhole } from "../src/transport/updates.ts";

const URL = "https://example.org/update.swz";

/** Replaces `fetch`: a response of this status whose body are these pieces; returns how many pieces were read. */
function serve(status: number, pieces: readonly Uint8Array[]): () => number {
  let sent = 0;
  const body = new ReadableStream<Uint8Array>(
    {
      pull(controller) {
        if (sent === pieces.length) controller.close();
        else controller.enqueue(pieces[sent++]!);
      },
    },
    { highWaterMark: 0 },
  );
  mock.method(globalThis, "fetch", async () => new Response(body, { status }));
  return () => sent;
}

afterEach(() => mock.restoreAll());

test("a file is read as a whole", async () => {
  serve(200, [Uint8Array.of(1, 2), Uint8Array.of(3)]);
  assert.deepEqual(await readWhole(URL), Uint8Array.of(1, 2, 3));
});

test("a missing file is null, a refusal an error", async () => {
  serve(404, []);
  assert.equal(await readWhole(URL), null);
  serve(503, []);
  await assert.rejects(readWhole(URL), HttpError);
});

test("a file that is larger than permitted is given up, without a declared size, too", async () => {
  const read = serve(
    200,
    Array.from({ length: 100 }, () => new Uint8Array(10)),
  );
  await assert.rejects(readWhole(URL, 25), /too large/);
  assert.equal(read(), 3);
});

test("of a file that is already there only the manifest is downloaded", async () => {
  const file = Uint8Array.from({ length: 100 }, (_, n) => n),
    pieces = Array.from({ length: 10 }, (_, n) => file.subarray(10 * n, 10 * n + 10));
  file.set([6, 0, 0, 0], 5); // size of the manifest
  const digest = manifestDigest(fileManifest(file)),
    read = serve(200, pieces);
  assert.equal(await readWhole(URL, 1000, digest), null);
  assert.equal(read(), 2);
  serve(200, pieces);
  assert.deepEqual(await readWhole(URL, 1000, "00"), file);
});
