// Embed code for other pages refers to existing files.

import assert from "node:assert/strict";
import { test } from "node:test";

import { titleOf } from "../src/page/address.ts";
import { embedCode, readLink, viewpointOf, writeLink } from "../src/page/links.ts";

const STREAM = new URL("https://host/a/scene.swz?x=1&y=2");

test("embed code refers to the script of this page", () => {
  const code = embedCode(STREAM, "https://cdn.example/v1/splatwire.js?cached#x")!;
  assert.match(code, /src="https:\/\/cdn\.example\/v1\/splatwire\.js"/);
  assert.match(code, /src="https:\/\/host\/a\/scene\.swz\?x=1&amp;y=2"/);
});

test("embed code names no version of the stream, also of a private one or with a fragment", () => {
  for (const folder of ["streams", "private"]) {
    const tagged = `https://host/${folder}/scene.swz?7f753abe6c627689`;
    assert.match(embedCode(new URL(tagged), "https://host/splatwire.js")!, /\/scene\.swz" style=/);
    assert.match(embedCode(new URL(`${tagged}#x`), "https://host/splatwire.js")!, /\/scene\.swz#x" style=/);
  }
});

test("embed code repeats attributes", () => {
  const code = embedCode(STREAM, "https://host/splatwire.js", { up: "y", viewpoint: '0 0 "1' })!;
  assert.match(code, /y=2" up="y" viewpoint="0 0 &quot;1" style=/);
});

test("embed code keeps the query of a file on another server", () => {
  const other = new URL("https://host/get/scene.swz?7f753abe6c627689");
  assert.match(
    embedCode(other, "https://host/splatwire.js")!,
    /src="https:\/\/host\/get\/scene\.swz\?7f753abe6c627689"/,
  );
});

test("a stream that no other page can load has no embed code", () => {
  for (const src of ["blob:https://host/7", "data:,x", "file:///home/user/a.swz"])
    assert.equal(embedCode(new URL(src), "https://host/splatwire.js"), null, src);
});

test("an application's bundle, a packed page and a blob have no embed code", () => {
  for (const own of [
    "https://host/assets/index-Bx3.js",
    "file:///home/user/scene.html",
    "blob:https://host/7",
    "file:///a/splatwire.js",
    "http://127.0.0.1:5173/node_modules/.vite/deps/splatwire.js?v=5f0c2b1a", // Vite's server for development
    undefined, // esbuild with the format `iife`
    "/ROOT/node_modules/splatwire/splatwire.js",
  ])
    assert.equal(embedCode(STREAM, own), null, String(own));
});

test("links keep the page's other fields and its application's route", () => {
  const view = { eye: [1, 2, 3], target: [0, 0, 0], up: [0, 1, 0] } as const,
    settings = { concealer: "grow", lossRate: 0.5, burstLength: 1, seed: 0, sentShare: 1, show: "received" } as const,
    own = "concealer=grow&drop=0.5&view=1%2C2%2C3%2C0%2C0%2C0%2C0%2C1%2C0";
  for (const [before, after] of [
    ["", `#${own}`],
    ["#garden", `#garden&${own}`],
    ["#a=%20b&view=1,2&drop=0.1&turned=1", `#a=%20b&${own}`],
    ["#/rooms/3", `#/rooms/3?${own}`],
    ["#!/rooms/3?x=1&drop=0.1", `#!/rooms/3?x=1&${own}`],
  ]) {
    Object.assign(globalThis, { location: new URL(`https://host/page${before}`) });
    const link = writeLink(settings, view, null);
    assert.equal(link, `https://host/page${after}`);
    Object.assign(globalThis, { location: new URL(link) });
    const read = readLink("any");
    assert.deepEqual(read, { settings: { concealer: "grow", lossRate: 0.5 }, turned: false, viewpoint: view });
    assert.equal(writeLink(settings, view, null), link);
  }
});

test("a link to one of several scenes does not move the others", () => {
  const view = { eye: [1, 2, 3], target: [0, 0, 0], up: [0, 1, 0] } as const,
    settings = { concealer: "grow", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1, show: "received" } as const;
  Object.assign(globalThis, { location: new URL("https://host/page") });
  Object.assign(globalThis, { location: new URL(writeLink(settings, view, "a room")) });
  assert.deepEqual(readLink("a room").viewpoint, view);
  assert.equal(readLink("garden").viewpoint, null);
});

test("a viewpoint without a view is refused", () => {
  assert.deepEqual(viewpointOf("1 2 3 4 5 6 0 -9 0"), { eye: [1, 2, 3], target: [4, 5, 6], up: [0, -9, 0] });
  for (const wrong of [
    "0 0 0 0 0 0 0 0 0",
    "1 2 3 1 2 3 0 1 0",
    "1 2 3 4 5 6 0 0 0",
    "1e30 0 0 0 0 0 0 1 0",
    "1e-300 0 0 0 0 0 0 1 0",
    "1e308 0 0 -1e308 0 0 0 1 0",
    "NaN 0 0 1 0 0 0 1 0",
    "0 0 1 0 0 0 0 1",
  ])
    assert.equal(viewpointOf(wrong), null, wrong);
});

test("a scene is named after its file, or after the page if it has none", () => {
  for (const [src, title] of [
    ["https://host/a/a%20room.swz?token#x", "a room"],
    ["data:application/octet-stream;base64,AA/BBBB=", "Page"],
    ["blob:https://host/e1424ea9-8cf7-4c83", "Page"],
    [null, "Page"],
  ]) {
    const getAttribute = (name: string) => (name === "src" ? src : null);
    assert.equal(titleOf({ getAttribute, ownerDocument: { title: "Page" } } as unknown as HTMLElement), title);
  }
});
