// Pages whose Content Security Policy forbids a request: a final error with the directive and the address.

import assert from "node:assert/strict";
import { test } from "node:test";

test("a file that the page's policy forbids is a final error with the directive and the address", async () => {
  const world = globalThis as Record<string, unknown>,
    notes: ((event: object) => void)[] = [];
  world["addEventListener"] = (kind: string, note: (event: object) => void): void => {
    if (kind === "securitypolicyviolation") notes.push(note); // as in browsers
  };
  const { Server, URL_, visit } = await import("./fake_web.ts");
  const refuse = (blockedURI: string, disposition: string) => (): Promise<Response> => {
    // after the request has failed
    setTimeout(() => notes.map((note) => note({ blockedURI, disposition, effectiveDirective: "connect-src" })));
    return Promise.reject(new TypeError("Failed to fetch"));
  };
  const others = [refuse("https://other.example/", "enforce"), refuse(URL_, "report")],
    down = new Server((_, n) => (n < 4 ? others[n % 2]() : new Response(null, { status: 404 }))),
    visited = await visit();
  assert.match(visited.text, /404/); // after attempts without an answer, which the policy has not forbidden
  assert.ok(down.asked.length > 4);
  const server = new Server(refuse(URL_, "enforce")),
    { text, lost } = await visit();
  assert.equal(text, `the page's policy (CSP) forbids ${URL_}: allow it in connect-src`);
  assert.deepEqual([server.asked.length, lost.length], [1, 0]);
});
