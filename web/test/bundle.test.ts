// The served bundle as a program without a document imports it: a server that renders pages.

import assert from "node:assert/strict";
import { copyFileSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";

test("the served script can be imported without a document, and defines no element there", async () => {
  const folder = mkdtempSync(join(tmpdir(), "splatwire-bundle-")),
    module = join(folder, "splatwire.mjs");
  try {
    copyFileSync("../src/splatwire/web/splatwire.js", module);
    const before = Object.keys(globalThis);
    await import(pathToFileURL(module).href);
    assert.deepEqual(Object.keys(globalThis), before);
    assert.equal("customElements" in globalThis, false);
  } finally {
    rmSync(folder, { recursive: true });
  }
});
