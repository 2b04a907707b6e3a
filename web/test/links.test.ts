// Code for other pages names files that are there.

import assert from "node:assert/strict";
import { test } from "node:test";

import { embedCode } from "../src/page/links.ts";

const STREAM = new URL("https://host/a/scene.swz?x=1&y=2");

test("embed code names the script that this page runs", () => {
  const code = embedCode(STREAM, "https://cdn.example/v1/splatwire.js?cached#x")!;
  assert.match(code, /src="https:\/\/cdn\.example\/v1\/splatwire\.js"/);
  assert.match(code, /src="https:\/\/host\/a\/scene\.swz\?x=1&amp;y=2"/);
});

test("a part of somebody's bundle, a packed page and a blob have no code for other pages", () => {
  for (const own of [
    "https://host/assets/index-Bx3.js",
    "file:///tmp/scene.html",
    "blob:https://host/7",
    "file:///a/splatwire.js",
  ])
    assert.equal(embedCode(STREAM, own), null, own);
});
