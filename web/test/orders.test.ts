// One stream in several orders of its packets: files, sessions and what a browser has kept may each have their own.

import assert from "node:assert/strict";
import { test } from "node:test";

import { ContainerReader, fileHead } from "../src/packets/container.ts";
import type { Listener } from "../src/transport/events.ts";
import type { Transports } from "../src/transport/failover.ts";
import type { StoredStream } from "../src/transport/transfer.ts";
import type { SessionAddress } from "../src/transport/webtransport.ts";
import { dataView } from "../src/transport/wire_messages.ts";
import { type Answering, begun, Caches, packetOffsets, part, Server, type Visit, visit, whole } from "./fake_web.ts";
import { fileOf, random } from "./vectors.ts";

const KINDS = ["tiny_levels", "tiny_causal", "tiny_clip"].map(
  (name) => [name, fileOf(`../tests/golden/${name}.swz`)] as const,
);
const SESSION: SessionAddress = { url: "https://scenes.example:4840/splatwire" };

/** A file of the same head and other packets. */
function fileWith(file: Uint8Array, packets: readonly Uint8Array[]): Uint8Array {
  const container = new ContainerReader();
  container.feed(file);
  const size = dataView(file).getUint32(5, true),
    parts = [fileHead(file.subarray(9, 9 + size), container.head!.sideInfo)];
  for (const packet of packets) {
    const prefix = new Uint8Array(4);
    dataView(prefix).setUint32(0, packet.length, true);
    parts.push(prefix, packet);
  }
  return new Uint8Array(Buffer.concat(parts));
}

const packetsOf = (file: Uint8Array): Uint8Array[] => new ContainerReader().feed(file);

/** The same stream in other orders: reversed, shuffled, and with two neighbours swapped. */
function orders(file: Uint8Array): Uint8Array[] {
  const packets = packetsOf(file),
    numbers = random(5),
    shuffled = packets.map((packet) => [numbers(), packet] as const).sort(([a], [b]) => a - b),
    swapped = [...packets];
  [swapped[2], swapped[3]] = [swapped[3], swapped[2]];
  return [[...packets].reverse(), shuffled.map(([, packet]) => packet), swapped].map((some) => fileWith(file, some));
}

function assertWhole({ text, complete, verified, reception }: Visit): void {
  assert.deepEqual({ text, complete, verified }, { text: "complete", complete: true, verified: true });
  assert.equal(reception.store.complete, true);
}

/** Gives some bytes of a file, breaks off, and then knows the file no more. */
const breaksOff = (file: Uint8Array, bytes: number): Answering => {
  let n = 0;
  return () =>
    n++
      ? new Response(null, { status: 404 })
      : begun(
          file.slice(0, bytes),
          { status: 206, headers: { "Content-Range": `bytes 0-${file.length - 1}/${file.length}` } },
          "breaks",
        );
};

/** A session in the order of a file: it leaves out what the page has of this order, and ends after some packets. */
function sessionOf(
  file: Uint8Array,
  order: string,
  count: number,
  ends: string,
  noteSent: (count: number) => void = () => undefined,
): Transports["receiveDatagrams"] {
  return async (_session: SessionAddress, _name: string, listener: Listener, before: StoredStream | null = null) => {
    const container = new ContainerReader(),
      packets = container.feed(file),
      bits = before?.bitsOf(order) ?? null;
    if (before) listener.confirmed?.();
    else listener.head(container.head!, container.headBytes, true);
    const sent = packets
      .map((bytes, position) => ({ order, position, bytes }))
      .filter(({ position }) => !bits || !((bits[position >> 3] >> (position & 7)) & 1));
    listener.packets(sent.slice(0, count));
    noteSent(Math.min(sent.length, count));
    if (sent.length > count) throw new Error(ends);
    return "complete";
  };
}

for (const [kind, file] of KINDS) {
  test(`${kind}: a file in another order than what an earlier visit kept is whole within one visit`, async () => {
    for (const other of orders(file))
      for (const share of [0.5, 0.97]) {
        const caches = new Caches(),
          server = new Server(breaksOff(file, Math.floor(share * file.length)));
        await visit(caches);
        for (const answering of [(asked) => part(other, asked), () => whole(other)] satisfies Answering[]) {
          server.answering = answering;
          const copy = new Caches();
          for (const [key, bytes] of caches.entries) copy.entries.set(key, bytes);
          for (let n = 0; n < 2; n++) assertWhole(await visit(copy));
        }
        assert.ok(server.asked.length < 60, `${server.asked.length} requests`);
      }
  });

  test(`${kind}: a session in one order and a file in another one are whole within one visit`, async () => {
    for (const other of orders(file)) {
      const count = Math.floor(0.6 * packetsOf(file).length);
      let sessions = 0;
      const first = sessionOf(other, "one order", count, "the server fell silent"),
        ways: Partial<Transports> = {
          receiveDatagrams: (...given) => (sessions++ ? Promise.reject(new Error("no answer")) : first(...given)),
        };
      new Server((asked) => part(file, asked));
      const caches = new Caches();
      assertWhole(await visit(caches, { session: SESSION }, ways));
      assertWhole(await visit(caches));
    }
  });

  test(`${kind}: a file that breaks off is completed by a session in another order`, async () => {
    for (const other of orders(file)) {
      const caches = new Caches();
      new Server(breaksOff(file, Math.floor(0.6 * file.length)));
      await visit(caches);
      const ways: Partial<Transports> = { receiveDatagrams: sessionOf(other, "one order", Infinity, "") };
      assertWhole(await visit(caches, { session: SESSION }, ways));
    }
  });

  test(`${kind}: a session goes on in its own order, and begins again in another one`, async () => {
    const [other] = orders(file),
      count = Math.floor(0.5 * packetsOf(file).length);
    for (const next of ["one order", "another order"]) {
      const caches = new Caches();
      let sent = 0;
      new Server(() => new Response(null, { status: 404 }));
      let n = 0;
      const ways: Partial<Transports> = {
        receiveDatagrams: (...given) =>
          n++
            ? sessionOf(next === "one order" ? file : other, next, Infinity, "", (some) => (sent += some))(...given)
            : sessionOf(file, "one order", count, "the server fell silent", (some) => (sent += some))(...given),
      };
      assertWhole(await visit(caches, { session: SESSION }, ways));
      assert.equal(sent, packetsOf(file).length + (next === "one order" ? 0 : count));
    }
  });

  test(`${kind}: a session that ends as complete without all packets is not taken for complete`, async () => {
    const twice = [...packetsOf(file)];
    twice[1] = twice[0];
    new Server((asked) => part(file, asked));
    const ways: Partial<Transports> = { receiveDatagrams: sessionOf(fileWith(file, twice), "one order", Infinity, "") };
    assertWhole(await visit(new Caches(), { session: SESSION }, ways));
    new Server(() => new Response(null, { status: 404 }));
    const { text, complete } = await visit(new Caches(), { session: SESSION }, ways);
    assert.notEqual(text, "complete");
    assert.equal(complete, false);
  });

  test(`${kind}: offsets that two visits kept of files in two orders do not hide a missing packet`, async () => {
    const packets = packetsOf(file),
      moved = packets.slice(3, 5),
      other = fileWith(file, [...moved, ...packets.filter((packet) => !moved.includes(packet))]),
      [first, end] = [packetOffsets(other)[2] - 4, packetOffsets(file)[3] - 4],
      caches = new Caches(),
      server = new Server(breaksOff(other, first));
    await visit(caches);
    let isCut = false;
    server.answering = (asked) => {
      const [begin] = asked.range ?? [0];
      if (isCut) return new Response(null, { status: 404 });
      if (begin === 0) return part(file, asked); // the comparison of the manifest
      isCut = true;
      const range = `bytes ${begin}-${file.length - 1}/${file.length}`;
      return begun(file.slice(begin, end), { status: 206, headers: { "Content-Range": range } }, "breaks");
    };
    await visit(caches);
    server.answering = (asked) => part(file, asked);
    const before = server.asked.length;
    assertWhole(await visit(caches));
    assert.ok(server.asked.length - before < 20, `${server.asked.length - before} requests`);
  });

  test(`${kind}: servers with two orders that answer in turn give the whole scene`, async () => {
    for (const other of orders(file)) {
      const server = new Server((asked, n) => part(n % 2 ? other : file, asked)),
        caches = new Caches();
      assertWhole(await visit(caches));
      assertWhole(await visit(caches));
      assert.ok(server.asked.length < 40, `${server.asked.length} requests`);
    }
  });

  test(`${kind}: a flipped bit of a size field costs its packet on the way, and nothing stays of it`, async () => {
    const offsets = packetOffsets(file);
    for (const n of [0, Math.floor(offsets.length / 2)])
      for (const bit of [2, 9, 30]) {
        const at = offsets[n] - 4 + (bit >> 3),
          damaged = file.slice(),
          caches = new Caches();
        damaged[at] ^= 1 << (bit & 7);
        let done = false;
        const server = new Server((asked) => {
          const [first, end] = asked.range ?? [0, Infinity],
            now = !done && first <= at && at < end;
          done ||= now;
          return part(now ? damaged : file, asked);
        });
        assertWhole(await visit(caches));
        assert.ok(server.bytes(file.length) < 2.2 * file.length, `${server.bytes(file.length)} bytes`);
        server.answering = (asked) => part(file, asked);
        assertWhole(await visit(caches));
        const stays = new Server((asked) => part(damaged, asked)),
          again = new Caches(),
          { reception, complete } = await visit(again);
        assert.equal(complete, false);
        assert.equal(reception.store.count, offsets.length - 1, `bit ${bit} of packet ${n}`);
        stays.answering = (asked) => part(file, asked);
        assertWhole(await visit(again));
      }
  });
}
