// Datagrams of the wire protocol, version 3 (docs/transport.md): those that a browser writes and reads.

import type { Look } from "../codec/levels/cut.ts";
import { crc32 } from "../packets/crc32.ts";

const VERSION = 3;
export const REQUEST = 3,
  WELCOME = 4,
  SIDE = 5,
  DATA = 6,
  FEEDBACK = 8,
  BYE = 9,
  REFUSE = 10,
  END = 11,
  HAVE = 12,
  VIEW = 13;
/** Added to the number of a datagram that is asked for again by it, not by the place of its packet. */
export const BY_SEQUENCE = 2 ** 31;
export const MAX_DATAGRAM = 1200,
  MAX_HEAD_BYTES = 2 ** 28,
  MAX_PACKETS = 2 ** 21;
const MAX_TIERS = 130,
  MAX_DECLARED = 1104,
  MAX_PREVIEW = 1024,
  MAX_HELD_BYTES = 1100;

export const viewOf = (bytes: Uint8Array): DataView => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

/** A frame: byte 0, what `fill` writes behind it, and a CRC-32 of all that. */
function frame(kind: number, size: number, fill: (numbers: DataView, bytes: Uint8Array) => void): Uint8Array {
  const bytes = new Uint8Array(1 + size + 4),
    numbers = viewOf(bytes);
  bytes[0] = (VERSION << 4) | kind;
  fill(numbers, bytes);
  numbers.setUint32(1 + size, crc32(bytes.subarray(0, 1 + size)), true);
  return bytes;
}

/** Kind of a datagram whose checksum holds (that of a packet in `DATA` is its own); 0 for anything else. */
export function kindOf(bytes: Uint8Array): number {
  if (bytes.length < 6 || bytes[0] >> 4 !== VERSION) return 0;
  const kind = bytes[0] & 15,
    end = bytes.length - 4;
  return kind === DATA || crc32(bytes.subarray(0, end)) === viewOf(bytes).getUint32(end, true) ? kind : 0;
}

export interface Welcome {
  readonly session: number;
  readonly streamId: number;
  readonly headBytes: number;
  readonly digest: Uint8Array;
  readonly symbolBytes: number;
  readonly packets: number;
  readonly packetBytes: number;
  /** Packets that travel in the head. */
  readonly carried: number;
  /** Whether what is looked at comes first, once the server is told: a last tier of 0 packets, 0 groups, 2 symbols. */
  readonly viewable: boolean;
  /** Whether the stream grows, and others follow it: a last tier of 0 packets, 0 groups, 1 symbol. */
  readonly open: boolean;
  readonly preview: Uint8Array;
}

/** What a server declares; null if it is impossible or answers another request. */
export function readWelcome(bytes: Uint8Array, nonce: bigint): Welcome | null {
  if (bytes.length < 76) return null;
  const numbers = viewOf(bytes),
    tiers = bytes[69],
    at = 70 + 8 * tiers;
  if (!(tiers >= 1 && tiers <= MAX_TIERS) || at + 2 > bytes.length - 4) return null;
  const size = numbers.getUint16(at, true),
    headBytes = Number(numbers.getBigUint64(17, true));
  if (size > MAX_PREVIEW || size + 8 * tiers > MAX_DECLARED || at + 2 + size !== bytes.length - 4) return null;
  const welcome = {
    session: numbers.getUint32(9, true),
    streamId: numbers.getUint32(13, true),
    headBytes,
    digest: bytes.slice(25, 57),
    symbolBytes: numbers.getUint16(57, true),
    packets: numbers.getUint32(59, true),
    packetBytes: numbers.getUint16(63, true),
    carried: numbers.getUint32(65, true),
    viewable: numbers.getBigUint64(at - 8, true) === 2n << 48n,
    open: numbers.getBigUint64(at - 8, true) === 1n << 48n,
    preview: bytes.slice(at + 2, at + 2 + size),
  };
  const fine =
    numbers.getBigUint64(1, true) === nonce &&
    headBytes > 0 &&
    headBytes <= MAX_HEAD_BYTES &&
    welcome.symbolBytes > 0 &&
    welcome.packets <= MAX_PACKETS &&
    welcome.carried <= welcome.packets;
  return fine ? welcome : null;
}

export function writeRequest(nonce: bigint, name: string): Uint8Array {
  const text = new TextEncoder().encode(name);
  return frame(REQUEST, 25 + text.length, (numbers, bytes) => {
    numbers.setBigUint64(1, nonce, true);
    bytes[25] = text.length;
    bytes.set(text, 26);
  });
}

export interface Report {
  readonly session: number;
  readonly largest: number;
  readonly received: number;
  /** The receiver's clock when the largest came, microseconds. */
  readonly clock: number;
  readonly symbolsMissing: number;
  readonly lost: readonly number[];
}

export function writeFeedback(report: Report): Uint8Array {
  return frame(FEEDBACK, 22 + 4 * report.lost.length, (numbers) => {
    const { session, largest, received, clock, symbolsMissing, lost } = report;
    [session, largest, received, clock % 2 ** 32, symbolsMissing].forEach((value, n) =>
      numbers.setUint32(1 + 4 * n, value, true),
    );
    numbers.setUint16(21, lost.length, true);
    lost.forEach((place, n) => numbers.setUint32(23 + 4 * n, place, true));
  });
}

/** What there is of a stream from before: its head, and the packets of which `held` has a bit; as many as it takes. */
export function writeHave(nonce: bigint, streamId: number, held: Uint8Array): Uint8Array[] {
  return Array.from({ length: Math.ceil(held.length / MAX_HELD_BYTES) || 1 }, (_, n) => {
    const first = MAX_HELD_BYTES * n,
      part = held.subarray(first, first + MAX_HELD_BYTES);
    return frame(HAVE, 17 + part.length, (numbers, bytes) => {
      numbers.setBigUint64(1, nonce, true);
      numbers.setUint32(9, streamId, true);
      bytes[13] = 1;
      numbers.setUint32(14, 8 * first, true);
      bytes.set(part, 18);
    });
  });
}

/** Where somebody looks from: `number` counts what is said of it. */
export function writeView(session: number, number: number, look: Look, budget: number): Uint8Array {
  return frame(VIEW, 68, (numbers) => {
    const { viewmat, focal, width, height } = look;
    [session, number, budget].forEach((value, n) => numbers.setUint32(1 + 4 * n, value, true));
    [width, height].forEach((value, n) => numbers.setUint16(13 + 2 * n, Math.min(Math.round(value), 65535), true));
    const rows = viewmat.slice(0, 3).flat();
    [focal, ...rows].forEach((value, n) => numbers.setFloat32(17 + 4 * n, value, true));
  });
}

export function writeBye(session: number): Uint8Array {
  return frame(BYE, 4, (numbers) => numbers.setUint32(1, session, true));
}

/** Cuts a reliable stream into frames: each behind its size, u16. */
export class FrameReader {
  #rest = new Uint8Array();

  feed(chunk: Uint8Array): Uint8Array[] {
    const bytes = new Uint8Array(this.#rest.length + chunk.length),
      frames: Uint8Array[] = [];
    bytes.set(this.#rest);
    bytes.set(chunk, this.#rest.length);
    let at = 0;
    while (bytes.length - at >= 2) {
      const size = bytes[at] | (bytes[at + 1] << 8);
      if (size < 1 || size > MAX_DATAGRAM) throw new Error(`a frame of ${size} bytes on the stream`);
      if (bytes.length - at < 2 + size) break;
      frames.push(bytes.slice(at + 2, at + 2 + size));
      at += 2 + size;
    }
    this.#rest = bytes.slice(at);
    return frames;
  }
}
