// Messages of the wire protocol, version 4 (docs/wire.md), as far as browsers write and read them.

import type { ViewCamera } from "../codec/levels/cut.ts";
import { joined } from "../packets/container.ts";
import { crc32 } from "../packets/crc32.ts";
import { sha256 } from "../sha256.ts";
import {
  BYE,
  DATA,
  FEEDBACK,
  HAVE,
  LIVE,
  MAX_DATAGRAM,
  MAX_DECLARED,
  MAX_HELD_BYTES,
  MAX_INIT_SEGMENT_BYTES,
  MAX_PACKETS,
  MAX_PARITY_RANGES,
  MAX_PREVIEW,
  REQUEST,
  VERSION,
  VIEW_DEPENDENT,
  VIEW_UPDATE,
} from "./wire.ts";

/** Bytes of `Welcome.orderDigest`. */
const ORDER_BYTES = 16;

export const dataView = (bytes: Uint8Array): DataView => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

/** Builds a message: byte 0, the fields that `fill` writes, and a CRC-32 of both. */
function message(kind: number, size: number, fill: (view: DataView, bytes: Uint8Array) => void): Uint8Array {
  const bytes = new Uint8Array(1 + size + 4),
    view = dataView(bytes);
  bytes[0] = (VERSION << 4) | kind;
  fill(view, bytes);
  view.setUint32(1 + size, crc32(bytes.subarray(0, 1 + size)), true);
  return bytes;
}

/**
 * Returns the type of a message with a correct checksum, 0 for anything else. Packets in `DATA` have their own
 * checksum.
 */
export function messageKind(bytes: Uint8Array): number {
  if (bytes.length < 6 || bytes[0] >> 4 !== VERSION) return 0;
  const kind = bytes[0] & 15,
    end = bytes.length - 4;
  return kind === DATA || crc32(bytes.subarray(0, end)) === dataView(bytes).getUint32(end, true) ? kind : 0;
}

export interface Welcome {
  readonly session: number;
  readonly streamId: number;
  readonly initSegmentBytes: number;
  readonly digest: Uint8Array;
  readonly symbolBytes: number;
  readonly packets: number;
  /** Size of the largest packet, bytes; for a live stream, the largest size that a packet may have. */
  readonly maxPacketBytes: number;
  /** Number of packets bundled with the init segment. */
  readonly bundled: number;
  /** True if the order of the packets depends on the client's view: its tiles come first. */
  readonly viewDependent: boolean;
  /** True for a live stream: it may still grow, or another period may follow. */
  readonly isLive: boolean;
  readonly preview: Uint8Array;
  /** Digest of everything that determines the packets' positions: the init segment and the layout, hexadecimal. */
  readonly orderDigest: string;
}

/** Reads a welcome message. Returns null if it is implausible or answers another request. */
export function readWelcome(bytes: Uint8Array, nonce: bigint): Welcome | null {
  if (bytes.length < 77) return null;
  const view = dataView(bytes),
    flags = bytes[69],
    ranges = bytes[70],
    previewOffset = 71 + 8 * ranges;
  if (
    flags > (LIVE | VIEW_DEPENDENT) ||
    !(ranges >= 1 && ranges <= MAX_PARITY_RANGES) ||
    previewOffset + 2 > bytes.length - 4
  )
    return null;
  const size = view.getUint16(previewOffset, true),
    initSegmentBytes = Number(view.getBigUint64(17, true));
  if (size > MAX_PREVIEW || size + 8 * ranges > MAX_DECLARED || previewOffset + 2 + size !== bytes.length - 4)
    return null;
  const welcome = {
    session: view.getUint32(9, true),
    streamId: view.getUint32(13, true),
    initSegmentBytes,
    digest: bytes.slice(25, 57),
    symbolBytes: view.getUint16(57, true),
    packets: view.getUint32(59, true),
    maxPacketBytes: view.getUint16(63, true),
    bundled: view.getUint32(65, true),
    viewDependent: (flags & VIEW_DEPENDENT) > 0,
    isLive: (flags & LIVE) > 0,
    preview: bytes.slice(previewOffset + 2, previewOffset + 2 + size),
    orderDigest: sha256(bytes.subarray(13, previewOffset)).slice(0, 2 * ORDER_BYTES),
  };
  const isValid =
    view.getBigUint64(1, true) === nonce &&
    initSegmentBytes > 0 &&
    initSegmentBytes <= MAX_INIT_SEGMENT_BYTES &&
    welcome.symbolBytes > 0 &&
    welcome.packets <= MAX_PACKETS &&
    welcome.bundled <= welcome.packets;
  return isValid ? welcome : null;
}

export function writeRequest(nonce: bigint, name: string): Uint8Array {
  const text = new TextEncoder().encode(name);
  return message(REQUEST, 25 + text.length, (view, bytes) => {
    view.setBigUint64(1, nonce, true);
    bytes[25] = text.length;
    bytes.set(text, 26);
  });
}

export interface Report {
  readonly session: number;
  readonly largest: number;
  readonly received: number;
  /** Receiver's clock at the arrival of the largest sequence number, microseconds. */
  readonly clock: number;
  readonly symbolsMissing: number;
  /** Indices of missing packets to send again. */
  readonly nacks: readonly number[];
  /** Sequence numbers of lost datagrams; their packets are to be sent again. */
  readonly lostSequences: readonly number[];
}

export function writeFeedback(report: Report): Uint8Array {
  const { session, largest, received, clock, symbolsMissing, nacks, lostSequences } = report,
    requested = [...nacks, ...lostSequences];
  return message(FEEDBACK, 24 + 4 * requested.length, (view) => {
    [session, largest, received, clock % 2 ** 32, symbolsMissing].forEach((value, n) =>
      view.setUint32(1 + 4 * n, value, true),
    );
    view.setUint16(21, nacks.length, true);
    view.setUint16(23, lostSequences.length, true);
    requested.forEach((number, n) => view.setUint32(25 + 4 * n, number, true));
  });
}

/** Builds messages that announce stored packets of a stream. `received` has one bit per packet. */
export function writeHave(nonce: bigint, streamId: number, received: Uint8Array): Uint8Array[] {
  return Array.from({ length: Math.ceil(received.length / MAX_HELD_BYTES) || 1 }, (_, n) => {
    const first = MAX_HELD_BYTES * n,
      part = received.subarray(first, first + MAX_HELD_BYTES);
    return message(HAVE, 17 + part.length, (view, bytes) => {
      view.setBigUint64(1, nonce, true);
      view.setUint32(9, streamId, true);
      bytes[13] = 1;
      view.setUint32(14, 8 * first, true);
      bytes.set(part, 18);
    });
  });
}

/** Builds a view update. `number` counts the updates. */
export function writeViewUpdate(session: number, number: number, camera: ViewCamera, budget: number): Uint8Array {
  return message(VIEW_UPDATE, 68, (view) => {
    const { viewmat, focal, width, height } = camera;
    [session, number, budget].forEach((value, n) => view.setUint32(1 + 4 * n, value, true));
    [width, height].forEach((value, n) => view.setUint16(13 + 2 * n, Math.min(Math.round(value), 65535), true));
    const rows = viewmat.slice(0, 3).flat();
    [focal, ...rows].forEach((value, n) => view.setFloat32(17 + 4 * n, value, true));
  });
}

export function writeBye(session: number): Uint8Array {
  return message(BYE, 4, (view) => view.setUint32(1, session, true));
}

/** Splits a reliable stream into messages, each preceded by its size as u16. */
export class MessageReader {
  #rest: Uint8Array = new Uint8Array();

  feed(chunk: Uint8Array): Uint8Array[] {
    const bytes = joined(this.#rest, chunk),
      messages: Uint8Array[] = [];
    let offset = 0;
    while (bytes.length - offset >= 2) {
      const size = bytes[offset] | (bytes[offset + 1] << 8);
      if (size < 1 || size > MAX_DATAGRAM) throw new Error(`a message of ${size} bytes on the stream`);
      if (bytes.length - offset < 2 + size) break;
      messages.push(bytes.slice(offset + 2, offset + 2 + size));
      offset += 2 + size;
    }
    this.#rest = bytes.slice(offset);
    return messages;
  }
}
