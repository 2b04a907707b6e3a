import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { type Head, HeadReader } from "../src/packets/container.ts";
import { crc32, portableCrc32 } from "../src/packets/crc32.ts";
import { sha256 } from "../src/sha256.ts";
import { Transfer } from "../src/transport/transfer.ts";
import {
  END,
  INIT_SYMBOL,
  LIVE,
  MAX_FRUITLESS_ENDS,
  MAX_NACK_ATTEMPTS,
  NACK_INTERVAL_MS,
  NOT_YET,
  PARITY,
  REFUSE,
  REORDER_THRESHOLD,
  VERSION,
  VIEW_DEPENDENT,
} from "../src/transport/wire.ts";
import { dataView, MessageReader, readWelcome, writeRequest } from "../src/transport/wire_messages.ts";
import { fileOf } from "./vectors.ts";
import { empty, welcome } from "./wire_messages.ts";

const expected = process.env["EXPECTED"]
  ? (JSON.parse(readFileSync(process.env["EXPECTED"], "utf8")) as { request: string; welcome: string })
  : null;

/** Returns the init segment, without bundled packets, of a stream's file. */
function initSegmentOf(file: Uint8Array): Uint8Array {
  const head = new HeadReader();
  head.feed(file);
  return head.headBytes.subarray(5);
}

test("message bytes equal Python's", { skip: expected === null && "EXPECTED is not set" }, () => {
  assert.equal(Buffer.from(writeRequest(7n, "scène")).toString("hex"), expected!.request);
  const found = readWelcome(Uint8Array.from(Buffer.from(expected!.welcome, "hex")), 7n);
  const { digest, preview, orderDigest, ...numbers } = found!;
  assert.deepEqual(numbers, {
    session: 2,
    streamId: 3,
    initSegmentBytes: 400,
    symbolBytes: 256,
    packets: 12,
    maxPacketBytes: 1150,
    bundled: 4,
    viewDependent: true,
    isLive: false,
  });
  assert.equal(Buffer.from(preview).toString(), "preview");
  assert.equal(digest.length, 32);
  assert.match(orderDigest, /^[0-9a-f]{32}$/);
});

test("the checksum equals zlib's, also in two parts", () => {
  const bytes = new TextEncoder().encode("123456789");
  for (const checksum of [crc32, portableCrc32]) {
    assert.equal(checksum(bytes, 0), 0xcbf43926);
    for (let n = 0; n < bytes.length; n++)
      assert.equal(checksum(bytes.subarray(n), checksum(bytes.subarray(0, n), 0)), 0xcbf43926);
  }
});

test("a live stream that has not begun is requested again, four times a second", () => {
  const transfer = new Transfer("live", 7n, 0);
  const notYet = new Uint8Array(14);
  notYet[0] = (VERSION << 4) | REFUSE;
  dataView(notYet).setBigUint64(1, 7n, true);
  notYet[9] = NOT_YET;
  dataView(notYet).setUint32(10, crc32(notYet.subarray(0, 10)), true);
  transfer.receive(notYet, 100);
  assert.deepEqual([transfer.finished, transfer.waitUntil], [null, 350]);
});

test("implausible welcome messages are rejected", () => {
  const good = new Transfer("", 7n, 0);
  good.receive(welcome(), 0);
  assert.equal(good.welcome?.preview.length, 3);
  const wrong = [
    welcome((numbers) => numbers.setBigUint64(1, 8n, true)),
    welcome((numbers) => numbers.setBigUint64(17, 0n, true)),
    welcome((numbers) => numbers.setBigUint64(17, 2n ** 40n, true)),
    welcome((numbers) => numbers.setUint16(57, 0, true)),
    welcome((numbers) => numbers.setUint32(59, 2 ** 31, true)),
    welcome((_, bytes) => (bytes[70] = 0)),
    welcome((_, bytes) => (bytes[69] = 4)),
    welcome((numbers) => numbers.setUint16(79, 4, true)),
  ];
  for (const bytes of wrong) {
    const transfer = new Transfer("", 7n, 0);
    transfer.receive(bytes, 0);
    assert.equal(transfer.finished, "the server announces something impossible");
  }
});

test("datagrams with a wrong checksum are counted and ignored", () => {
  const transfer = new Transfer("", 7n, 0),
    damaged = welcome();
  damaged[20] ^= 1;
  transfer.receive(damaged, 0);
  assert.equal(transfer.welcome, null);
  assert.equal(transfer.counts.rejected, 1);
});

test("a limited number of datagrams before the welcome message is kept", () => {
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

test("a report lists missing packets behind the latest one, each at limited intervals", () => {
  const transfer = new Transfer("", 7n, 0);
  transfer.receive(
    welcome((numbers) => numbers.setUint32(59, 1000, true)),
    0,
  );
  transfer.receive(empty(100), 5);
  assert.equal(transfer.counts.packets, 1);
  const lost = (bytes: Uint8Array): number => dataView(bytes).getUint16(21, true);
  assert.equal(lost(transfer.feedback(10)), 100 + 1 - REORDER_THRESHOLD);
  assert.equal(lost(transfer.feedback(9 + NACK_INTERVAL_MS)), 0);
  assert.equal(lost(transfer.feedback(10 + NACK_INTERVAL_MS)), 100 + 1 - REORDER_THRESHOLD);
});

test("once a view was sent, lost datagrams are requested at limited intervals, a limited number of times", () => {
  const transfer = new Transfer("", 7n, 0),
    camera = { viewmat: [], focal: 1, width: 1, height: 1 };
  transfer.receive(
    welcome((numbers, bytes) => {
      numbers.setUint32(59, 1000, true);
      bytes[69] = VIEW_DEPENDENT;
    }),
    0,
  );
  transfer.viewUpdate(camera, 1);
  const arrive = (sequence: number): void => {
    const datagram = empty(sequence);
    dataView(datagram).setUint32(5, sequence, true);
    transfer.receive(datagram, 5);
  };
  arrive(REORDER_THRESHOLD + 2);
  const lost = (now: number): number[] => {
    const report = dataView(transfer.feedback(now));
    return Array.from({ length: report.getUint16(23, true) }, (_, n) => report.getUint32(25 + 4 * n, true));
  };
  assert.deepEqual(lost(10), [0, 1, 2]);
  assert.deepEqual(lost(9 + NACK_INTERVAL_MS), []);
  arrive(1); // it was only late
  for (let n = 1; n < MAX_NACK_ATTEMPTS; n++) assert.deepEqual(lost(10 + n * NACK_INTERVAL_MS), [0, 2]);
  assert.deepEqual(lost(10 + MAX_NACK_ATTEMPTS * NACK_INTERVAL_MS), []);
});

test("parity, which browsers do not use, counts as received and not as lost", () => {
  const transfer = new Transfer("", 7n, 0),
    parity = new Uint8Array(40);
  parity[0] = (VERSION << 4) | PARITY;
  transfer.receive(welcome(), 0);
  for (let sequence = 0; sequence < 3; sequence++) {
    dataView(parity).setUint32(5, sequence, true);
    transfer.receive(sealed(parity.slice()), 5);
  }
  assert.deepEqual([transfer.datagramsLost, transfer.counts.rejected, transfer.counts.packets], [0, 0, 0]);
  const report = dataView(transfer.feedback(10));
  assert.deepEqual([report.getUint32(5, true), report.getUint32(9, true)], [2, 3]);
});

test("many end messages at once after an outage do not end a transfer", () => {
  const transfer = new Transfer("", 7n, 0),
    end = new Uint8Array(13);
  transfer.receive(
    welcome((_, bytes) => (bytes[69] = 0)),
    0,
  );
  transfer.head = {} as Head;
  end[0] = (VERSION << 4) | END;
  dataView(end).setUint32(1, 2, true);
  dataView(end).setUint32(9, crc32(end.subarray(0, 9)), true);
  for (let n = 0; n < 3 * MAX_FRUITLESS_ENDS; n++) transfer.receive(end, 5000);
  assert.ok(!transfer.finished);
  for (let n = 1; n < MAX_FRUITLESS_ENDS; n++) transfer.receive(end, 5000 + 100 * n);
  assert.equal(transfer.finished, "sent");
});

test("packets of a live stream are requested a limited number of times, also after its end", () => {
  for (const isLive of [true, false]) {
    const transfer = new Transfer("", 7n, 0);
    let numRequests = 0;
    transfer.receive(
      welcome((numbers, bytes) => {
        numbers.setUint32(59, 1000, true);
        bytes[69] = isLive ? LIVE : 0;
      }),
      0,
    );
    transfer.receive(empty(REORDER_THRESHOLD), 5);
    for (let now = 10; now < 4000; now += 50) {
      if (now === 510)
        transfer.receive(
          welcome((numbers) => numbers.setUint32(59, 1000, true)),
          now,
        );
      numRequests += dataView(transfer.feedback(now)).getUint16(21, true);
    }
    assert.ok(isLive ? numRequests === MAX_NACK_ATTEMPTS : numRequests > 20, String(numRequests));
  }
});

test("positions that packets contradict count as missing, and both are requested again", () => {
  const transfer = new Transfer("", 7n, 0);
  transfer.receive(
    welcome((numbers) => numbers.setUint32(59, 100, true)),
    0,
  );
  for (let place = 0; place < 100; place++) if (place !== 5) transfer.receive(empty(place === 9 ? 5 : place, place), 1);
  assert.equal(transfer.counts.packets, 99);
  transfer.receive(empty(5), 2);
  assert.equal(transfer.counts.packets, 98);
  const lost = (): number[] => {
    const numbers = dataView(transfer.feedback(1000));
    return Array.from({ length: numbers.getUint16(21, true) }, (_, n) => numbers.getUint32(25 + 4 * n, true));
  };
  assert.deepEqual(lost(), [5, 9]);
  for (const place of [5, 9]) transfer.receive(empty(place), 1200);
  assert.equal(transfer.counts.packets, 100);
  const blocks = new Set(transfer.newPackets.map(({ bytes }) => bytes[7]));
  assert.equal(blocks.size, 100);
});

test("a server whose packets contradict each other without end is left", () => {
  const transfer = new Transfer("", 7n, 0);
  transfer.receive(welcome(), 0);
  for (let n = 0; n < 200; n++) transfer.receive(empty(n % 2, 0), n);
  assert.match(transfer.finished!, /contradict/);
});

test("packets are claimed only in the order in which they were received", () => {
  const manifest = { streamId: 3, numPackets: 10 },
    head = { manifest, sideInfo: new Uint8Array() } as unknown as Head,
    known = readWelcome(welcome(), 7n)!.orderDigest,
    before = {
      head,
      initSegment: new Uint8Array(8),
      bitsOf: (order: string) => (order === known ? Uint8Array.of(0b101, 0) : null),
    };
  const have = (change?: Parameters<typeof welcome>[0]): [boolean | null, number[]] => {
    const transfer = new Transfer("", 7n, 0, before);
    assert.deepEqual(transfer.takeHaveMessages(), [], "nothing is claimed before the welcome");
    transfer.receive(welcome(change), 0);
    return [transfer.isSameStream, transfer.takeHaveMessages().map((frame) => frame[18])];
  };
  assert.deepEqual(have(), [true, [0b101]]);
  assert.deepEqual(
    have((numbers) => numbers.setUint32(9, 77, true)),
    [true, [0b101]],
    "the session's number is no part of the order",
  );
  const others: Parameters<typeof welcome>[0][] = [
    (numbers) => numbers.setUint8(25, 1), // the digest
    (numbers) => numbers.setUint16(57, 264, true), // the size of symbols
    (numbers) => numbers.setUint32(65, 1, true), // packets in the head
    (numbers) => numbers.setUint32(70, 9, true), // packets of a tier
  ];
  for (const change of others) assert.deepEqual(have(change), [null, []]);
  assert.deepEqual(
    have((numbers) => numbers.setUint32(13, 4, true)),
    [false, []],
  );
});

test("a byte stream is split into messages for any chunk boundaries", () => {
  const reader = new MessageReader(),
    bytes = Uint8Array.of(2, 0, 7, 8, 1, 0, 9),
    messages: number[][] = [];
  for (const byte of bytes) messages.push(...reader.feed(Uint8Array.of(byte)).map((message) => [...message]));
  assert.deepEqual(messages, [[7, 8], [9]]);
  assert.throws(() => reader.feed(Uint8Array.of(0, 0)));
});

/** Message of the session, with a checksum. */
function sealed(bytes: Uint8Array): Uint8Array {
  const numbers = dataView(bytes);
  numbers.setUint32(1, 2, true);
  numbers.setUint32(bytes.length - 4, crc32(bytes.subarray(0, -4)), true);
  return bytes;
}

test("only messages that bring something new count as activity, unless nothing new exists", () => {
  const message = (kind: number, size: number, sequence = 0): Uint8Array => {
      const bytes = new Uint8Array(size);
      bytes[0] = (VERSION << 4) | kind;
      dataView(bytes).setUint32(5, sequence, true);
      return sealed(bytes);
    },
    symbol = message(INIT_SYMBOL, 15 + 256 + 4);
  for (const [flags, hasHead, mayIdle] of [
    [0, false, false],
    [LIVE, false, false],
    [0, true, false],
    [LIVE, true, true],
  ] as const) {
    const transfer = new Transfer("", 7n, 0),
      isProgress = (bytes: Uint8Array): boolean => {
        const before = transfer.activity;
        transfer.receive(bytes, 1);
        return transfer.activity !== before;
      },
      begin = welcome((_, bytes) => (bytes[69] = flags));
    assert.ok(!isProgress(new Uint8Array(900)), "garbage");
    assert.ok(isProgress(begin));
    if (hasHead) transfer.head = {} as Head;
    else assert.deepEqual([isProgress(symbol), isProgress(symbol)], [true, false]);
    assert.deepEqual([isProgress(empty(3)), isProgress(empty(3))], [true, false]);
    assert.equal(isProgress(message(END, 13, 1)), mayIdle);
    assert.ok(!isProgress(begin), "a repeated welcome message");
  }
});

test("a later welcome message that overtakes the stream gets only the symbols of its own init segment", () => {
  const head = initSegmentOf(fileOf("../tests/golden/tiny_clip.swz")),
    segments = [new Uint8Array(head.length).fill(7), head],
    size = 256;
  const welcomes = segments.map((segment, n) =>
    welcome((numbers, bytes) => {
      numbers.setBigUint64(17, BigInt(segment.length), true);
      bytes.set(Buffer.from(sha256(segment), "hex"), 25);
      numbers.setUint32(59, 10 + n, true);
      bytes[69] = LIVE;
    }),
  );
  const symbols = segments.map((segment) =>
    Array.from({ length: Math.ceil(segment.length / size) }, (_, n) => {
      const bytes = new Uint8Array(15 + size + 4);
      bytes[0] = (VERSION << 4) | INIT_SYMBOL;
      dataView(bytes).setUint32(1, 2, true);
      dataView(bytes).setUint32(11, n, true);
      bytes.set(segment.subarray(n * size, (n + 1) * size), 15);
      return sealed(bytes);
    }),
  );
  const transfer = new Transfer("", 7n, 0);
  transfer.receive(welcomes[0], 1, false);
  for (const one of symbols[0].slice(0, -1)) transfer.receive(one, 1, false);
  transfer.receive(welcomes[1], 2);
  transfer.receive(symbols[0].at(-1)!, 3, false);
  for (const one of symbols[0]) transfer.receive(one, 3);
  transfer.receive(welcomes[1], 4, false);
  for (const one of symbols[1]) transfer.receive(one, 4, false);
  assert.deepEqual([transfer.finished, transfer.numInitSegments], [null, 1]);
});

test("a limited number of packets is kept until the head arrives, and the others are requested", () => {
  const transfer = new Transfer("", 7n, 0),
    count = 40_000;
  transfer.receive(
    welcome((numbers) => numbers.setUint32(59, count, true)),
    0,
  );
  for (let place = 0; place < count; place++) transfer.receive(empty(place), 1);
  assert.ok(transfer.newPackets.length < 20_000, `${transfer.newPackets.length} packets`);
  const { length } = transfer.newPackets;
  assert.deepEqual([transfer.counts.packets, transfer.counts.rejected], [length, count - length]);
  transfer.head = {} as Head;
  transfer.newPackets = [];
  transfer.receive(empty(count - 1), 2);
  assert.equal(transfer.counts.packets, length + 1, "a refused packet may arrive again");
});
