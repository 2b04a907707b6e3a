import assert from "node:assert/strict";
import { test } from "node:test";

import { textsOf } from "../src/codec/metadata.ts";

const NONE = { title: "", author: "", license: "" };
const section = (text: string): Uint8Array => new TextEncoder().encode(text);

test("texts of a scene are read from its metadata", () => {
  const found = textsOf(
    section('{"title": "Yard\\n  at dawn", "author": "Ada", "license": "CC BY 4.0", "orbit": [0]}'),
  );
  assert.deepEqual(found, { title: "Yard at dawn", author: "Ada", license: "CC BY 4.0" });
});

test("invisible characters are left out and long texts are cut", () => {
  const title = `\u202eevil\u200b\u0000${"x".repeat(3000)}`,
    found = textsOf(section(JSON.stringify({ title, author: 7, license: null })));
  assert.match(found.title, /^evil x+$/);
  assert.deepEqual([found.title.length, found.author, found.license], [500, "", ""]);
});

test("characters that scripts and emoji need are kept", () => {
  const scotland = "\u{1f3f4}\u{e0067}\u{e0062}\u{e0073}\u{e0063}\u{e0074}\u{e007f}",
    persian = "\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645";
  for (const title of [persian, "\u{1f468}\u200d\u{1f469}", "\u{1fae8}", `a ${scotland} b`]) {
    assert.equal(textsOf(section(JSON.stringify({ title }))).title, title);
  }
  assert.equal(textsOf(section(JSON.stringify({ title: scotland.slice(0, -2) }))).title, "\u{1f3f4}");
  for (const length of [494, 497, 499]) {
    const title = "a".repeat(length);
    assert.equal(textsOf(section(JSON.stringify({ title: title + scotland }))).title, title);
  }
});

test("damaged metadata are no texts", () => {
  const damaged = [section(""), section("[1"), section("7"), section("null"), Uint8Array.of(0xff, 0xfe)];
  damaged.push(section(`{"title": "${"a".repeat(1 << 16)}"}`));
  for (const bytes of damaged) assert.deepEqual(textsOf(bytes), NONE);
  assert.deepEqual(textsOf(undefined), NONE);
});
