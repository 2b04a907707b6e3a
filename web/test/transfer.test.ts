import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { crc32 } from "../src/packets/crc32.ts";
import { FrameReader, readWelcome, viewOf, writeRequest } from "../src/transport/frames.ts";
import { Transfer } from "../src/transport/transfer.ts";

function sealed(bytes: Uint8Array): Uint8Array {
  const all = new Uint8Array(bytes.length + 4);
  all.set(bytes);
  viewOf(all).setUint32(bytes.length, crc32(bytes), true);
  return all;
}

/** A welcome of one tier that answers the nonce 7. */
function welcome(change: (numbers: DataView, bytes: Uint8Array) => void = () => undefined): Uint8Array {
  const bytes = new Uint8Array(70 + 8 + 2 + 3),
    numbers = viewOf(bytes);
  bytes[0] = 0x34;
  numbers.setBigUint64(1, 7n, true);
  numbers.setUint32(9, 2, true);
  numbers.setUint32(13, 3, true);
  numbers.setBigUint64(17, 400n, true);
  numbers.setUint16(57, 256, true);
  numbers.setUint32(59, 10, true);
  numbers.setUint16(63, 1150, true);
  bytes[69] = 1;
  numbers.setUint16(78, 3, true);
  change(numbers, bytes);
  return sealed(bytes);
}

const expected = process.env["EXPECTED"]
  ? (JSON.parse(readFileSync(process.env["EXPECTED"], "utf8")) as { request: string; welcome: string })
  : null;

test("frames are Python's", { skip: expected === null && "EXPECTED names no answers of Python" }, () => {
  assert.equal(Buffer.from(writeRequest(7n, "scène")).toString("hex"), expected!.request);
  const found = readWelcome(Uint8Array.from(Buffer.from(expected!.welcome, "hex")), 7n);
  const { digest, preview, ...numbers } = found!;
  assert.deepEqual(numbers, {
    session: 2,
    streamId: 3,
    headBytes: 400,
    symbolBytes: 256,
    packets: 12,
    packetBytes: 1150,
    carried: 4,
    viewable: false,
    open: false,
  });
  assert.equal(Buffer.from(preview).toString(), "preview");
  assert.equal(digest.length, 32);
});

test("the checksum is zlib's", () => assert.equal(crc32(new TextEncoder().encode("123456789")), 0xcbf43926));

test("a welcome is believed only if it is possible", () => {
  const good = new Transfer("", 7n, 0);
  good.receive(welcome(), 0);
  assert.equal(good.welcome?.preview.length, 3);
  const wrong = [
    welcome((numbers) => numbers.setBigUint64(1, 8n, true)),
    welcome((numbers) => numbers.setBigUint64(17, 0n, true)),
    welcome((numbers) => numbers.setBigUint64(17, 2n ** 40n, true)),
    welcome((numbers) => numbers.setUint16(57, 0, true)),
    welcome((numbers) => numbers.setUint32(59, 2 ** 31, true)),
    welcome((_, bytes) => (bytes[69] = 0)),
    welcome((numbers) => numbers.setUint16(78, 4, true)),
  ];
  for (const bytes of wrong) {
    const transfer = new Transfer("", 7n, 0);
    transfer.receive(bytes, 0);
    assert.equal(transfer.finished, "the server announces something impossible");
  }
});

test("what the checksum does not hold for is counted and left", () => {
  const transfer = new Transfer("", 7n, 0),
    damaged = welcome();
  damaged[20] ^= 1;
  transfer.receive(damaged, 0);
  assert.equal(transfer.welcome, null);
  assert.equal(transfer.counts.rejected, 1);
});

/** A datagram with an empty packet of block 0 for a place of the sending order. */
function empty(place: number): Uint8Array {
  const packet = new Uint8Array(24),
    numbers = viewOf(packet);
  packet[0] = 1;
  numbers.setUint32(1, 3, true);
  numbers.setUint16(10, 1, true);
  numbers.setUint32(12, crc32(packet.subarray(16), crc32(packet.subarray(0, 12))), true);
  const datagram = new Uint8Array(13 + packet.length);
  datagram[0] = 0x36;
  viewOf(datagram).setUint32(1, 2, true);
  viewOf(datagram).setUint32(9, place, true);
  datagram.set(packet, 13);
  return datagram;
}

test("what overtakes the welcome is kept, not without end", () => {
  const transfer = new Transfer("", 7n, 0),
    many = new Transfer("", 7n, 0);
  for (const place of [3, 4]) transfer.receive(empty(place), 1);
  transfer.receive(welcome(), 2);
  assert.deepEqual(
    [transfer.counts.packets, transfer.counts.rejected, transfer.counts.bytes],
    [2, 0, 2 * empty(0).length + welcome().length],
  );
  for (let place = 0; place < 100; place++) many.receive(empty(place), 1);
  many.receive(
    welcome((numbers) => numbers.setUint32(59, 1000, true)),
    2,
  );
  assert.deepEqual([many.counts.packets, many.counts.rejected], [64, 36]);
  many.receive(welcome(), 3);
  assert.equal(many.counts.rejected, 36);
});

test("a report names places that are missing behind the furthest, each not too often", () => {
  const transfer = new Transfer("", 7n, 0);
  transfer.receive(
    welcome((numbers) => numbers.setUint32(59, 1000, true)),
    0,
  );
  transfer.receive(empty(100), 5);
  assert.equal(transfer.counts.packets, 1);
  const lost = (bytes: Uint8Array): number => viewOf(bytes).getUint16(21, true);
  assert.equal(lost(transfer.feedback(10)), 100 + 1 - 48);
  assert.equal(lost(transfer.feedback(20)), 0);
  assert.equal(lost(transfer.feedback(140)), 100 + 1 - 48);
});

test("a stream is cut into frames wherever its pieces end", () => {
  const reader = new FrameReader(),
    bytes = Uint8Array.of(2, 0, 7, 8, 1, 0, 9),
    frames: number[][] = [];
  for (const byte of bytes) frames.push(...reader.feed(Uint8Array.of(byte)).map((frame) => [...frame]));
  assert.deepEqual(frames, [[7, 8], [9]]);
  assert.throws(() => reader.feed(Uint8Array.of(0, 0)));
});
