// Pages whose Content Security Policy forbids a request: a final error with the directive and the address.

import assert from "node:assert/strict";
import { test } from "node:test";

const page = globalThis as Record<string, unknown>,
  listeners = new Set<(event: object) => void>();
page["addEventListener"] = (kind: string, listener: (event: object) => void): void => {
  if (kind === "securitypolicyviolation") listeners.add(listener); // as in browsers
};
page["removeEventListener"] = (_: string, listener: (event: object) => void): void => void listeners.delete(listener);
const { Server, URL_, visit } = await import("./fake_web.ts"),
  { permitted } = await import("../src/transport/page_policy.ts");

/** Reports violations of the policy, after the request that a task started has failed. */
function report(...blocked: readonly { blockedURI: string; disposition?: string }[]): void {
  setTimeout(() => {
    for (const violation of blocked)
      for (const listener of listeners)
        listener({ disposition: "enforce", effectiveDirective: "connect-src", ...violation });
  });
}

/** Returns the error message of a request that fails and is followed by these reports. */
async function errorOf(url: string, ...blockedURIs: readonly string[]): Promise<string> {
  report(...blockedURIs.map((blockedURI) => ({ blockedURI })));
  return permitted(url, Promise.reject(new TypeError("Failed to fetch"))).catch(({ message }: Error) => message);
}

test("a file that the page's policy forbids is a final error with the directive and the address", async () => {
  const refuse = (blockedURI: string, disposition: string) => (): Promise<Response> => {
    report({ blockedURI, disposition });
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

test("a violation belongs to the request of exactly its address, or of its origin if no more is reported", async () => {
  const url = "https://scenes.example/a.swz?token=1#part",
    forbids = (address: string): string => `the page's policy (CSP) forbids ${address}: allow it in connect-src`;
  assert.equal(await errorOf(url, "https://scenes.example/a.swz?token=1"), forbids("https://scenes.example/a.swz"));
  assert.equal(await errorOf(url, "https://scenes.example"), forbids("https://scenes.example"));
  for (const other of ["", "inline", "https", "https://scenes.example/a", "https://scenes.example/a.swz?token=10"])
    assert.equal(await errorOf(url, other), "Failed to fetch", other);
  assert.equal(await errorOf("blob:https://scenes.example/1-2-3", "blob"), forbids("blob"));
});

test("violations by other requests do not hide that of a request", async () => {
  const url = "https://scenes.example/a.swz";
  assert.match(await errorOf(url, url, "https://other.example/picture.png", "inline"), /forbids .*a\.swz/);
});

test("nothing listens for violations after a request has ended", async () => {
  await permitted("https://scenes.example/a.swz", Promise.resolve());
  await errorOf("https://scenes.example/b.swz");
  assert.equal(listeners.size, 0);
});
