// Sessions and files of a stream in turn: what is final, what is tried again, and which reason a visitor gets.

import assert from "node:assert/strict";
import { test } from "node:test";

import { ContainerReader } from "../src/packets/container.ts";
import type { Ways } from "../src/transport/attempts.ts";
import { NoWebTransport, type Session } from "../src/transport/webtransport.ts";
import { Caches, part, Server, visit } from "./fake_web.ts";
import { fileOf } from "./vectors.ts";

const STILL = fileOf("../tests/golden/tiny_causal.swz"),
  SESSION: Session = { url: "https://scenes.example:4840/splatwire" };

/** Sessions that end with these words, one after another; errors are thrown. */
function sessions(...ends: (string | Error)[]): { ways: Partial<Ways>; opened: Session[] } {
  const opened: Session[] = [];
  const receiveDatagrams = async (session: Session): Promise<string> => {
    opened.push(session);
    const end = ends.shift() ?? "complete";
    if (end instanceof Error) throw end;
    return end;
  };
  return { ways: { receiveDatagrams }, opened };
}

const noFile = (): Response => new Response(null, { status: 404, statusText: "Not Found" });
const down = (): Error => new Error("no answer to a WebTransport session");

test("joining a live clip over a link that is down goes on once the link is up", async () => {
  new Server(noFile);
  const { ways, opened } = sessions(down(), down(), down(), down()),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.equal(text, "complete");
  assert.equal(opened.length, 5);
  assert.equal(lost.length, 4);
  for (const reason of lost) assert.match(reason, /no answer to a WebTransport session/);
});

test("a live clip is tried again where its server is full", async () => {
  new Server(noFile);
  const { ways } = sessions(new Error("the server is full")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual([text, lost.length], ["complete", 1]);
  assert.match(lost[0], /the server is full/);
});

test("a stream that neither sessions nor files know is an error at once", async () => {
  new Server(noFile);
  const { ways, opened } = sessions(new Error("no such stream")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.match(text, /404/);
  assert.deepEqual([opened.length, lost.length], [1, 0]);
});

test("a browser without WebTransport gets both reasons for a live clip at once", async () => {
  new Server(noFile);
  const { ways } = sessions(new NoWebTransport("this browser or page has no WebTransport")),
    { text, lost } = await visit(null, { session: SESSION }, ways);
  assert.match(text, /404.*no WebTransport/);
  assert.equal(lost.length, 0);
});

test("a server that could not be asked for its sessions is asked again where it has no file", async () => {
  new Server(noFile);
  const { ways, opened } = sessions("complete"),
    { text } = await visit(null, {}, { ...ways, askServer: async () => SESSION });
  assert.equal(text, "complete");
  assert.deepEqual(opened, [SESSION]);
});

test("a session that brings nothing gives way to the file", async () => {
  new Server((asked) => part(STILL, asked));
  const { ways } = sessions(down()),
    { text, verified, said } = await visit(null, { session: SESSION }, ways);
  assert.deepEqual([text, verified], ["complete", true]);
  assert.ok(said.some((one) => one.kind === "note" && /by HTTP: no answer/.test(one.text)));
});

test("what is kept whole is compared over a session where there is no file", async () => {
  const caches = new Caches(),
    server = new Server((asked) => part(STILL, asked));
  await visit(caches);
  server.answering = noFile;
  const { ways, opened } = sessions("complete"),
    { text, lost } = await visit(caches, { session: SESSION }, ways);
  assert.deepEqual([text, opened.length, lost.length], ["complete", 1, 0]);
});

test("a file that is refused for a moment after it was read is requested again, not for ever", async () => {
  for (const [times, expected] of [
    [3, /^complete$/],
    [99, /404/],
  ] as const) {
    const server = new Server((asked, n) => (n > 0 && n <= times ? noFile() : part(STILL, asked))),
      { text } = await visit();
    assert.match(text, expected);
    assert.ok(server.asked.length < 20);
  }
});

test("a file in another order than the session's is whole at the latest on the next visit", async () => {
  const caches = new Caches(),
    reader = new ContainerReader(),
    packets = reader.feed(STILL);
  let falls = true;
  const ways: Partial<Ways> = {
    receiveDatagrams: async (_session, _limits, listener) => {
      if (!falls) throw down();
      falls = false;
      listener.head(reader.head!, reader.headBytes, true);
      listener.packets([{ place: 0, bytes: packets[1] }]);
      throw new Error("the server fell silent");
    },
  };
  new Server((asked) => part(STILL, asked));
  assert.equal((await visit(caches, { session: SESSION }, ways)).verified, false);
  const { complete, verified } = await visit(caches);
  assert.deepEqual({ complete, verified }, { complete: true, verified: true });
});
