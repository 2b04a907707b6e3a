// Parser for the packets of a file that arrives in pieces. Intact packets are delivered, damaged bytes skipped.

import { BitstreamError } from "../bytes.ts";
import { type Head, HeadReader, joined } from "../packets/container.ts";
import { MAX_PACKET_BYTES } from "../packets/limits.ts";
import { HEADER_BYTES } from "../packets/packet.ts";
import { FILE_ORDER, type Listener, type ReceivedPacket } from "./events.ts";
import { isIntact, type PacketStore, SIZE_BYTES } from "./packet_store.ts";
import { dataView } from "./wire_messages.ts";

/** Bytes parsed at once, because a browser delivers all data that waited for a busy thread. */
const PIECE = 1 << 16;
/** Number of consecutive damaged packets after which the rest is skipped. */
const MAX_DAMAGED_IN_A_ROW = 8;
/** Number of consecutive bytes without the beginning of a packet after which the rest is skipped. */
const MAX_SKIPPED = 1 << 22;
/** First byte of every packet: its version. */
const PACKET_VERSION = 1;

/** Error for bytes that do not belong to the stream: damaged, or of a replaced file. */
export class Damaged extends Error {}

/**
 * Finds the intact packets after the head of a file. Size fields have no checksum. After damaged bytes, the version and
 * the stream id identify the next packet.
 */
export class PacketScanner {
  /** True once too many consecutive bytes were damaged. */
  broken = false;
  readonly #pattern = new Uint8Array(5);
  readonly #maxSize: number;
  #rest: Uint8Array = new Uint8Array();
  #damaged = 0;
  #skipped = 0;
  /** True while the beginning of the next packet is searched. */
  #isSearching = false;

  /** `offset` is that of the first byte in the file. */
  constructor(
    readonly head: Head,
    private offset: number,
  ) {
    this.#pattern[0] = PACKET_VERSION;
    dataView(this.#pattern).setUint32(1, head.manifest.streamId, true);
    this.#maxSize = Math.min(head.manifest.packetization.packetBytes, MAX_PACKET_BYTES);
  }

  /** Offset and bytes of a packet that is not complete. */
  get begun(): { readonly offset: number; readonly bytes: Uint8Array } {
    return { offset: this.offset, bytes: this.#isSearching ? new Uint8Array() : this.#rest };
  }

  /** Adds bytes and returns the packets that are now complete. `last` is true at the end of the data. */
  feed(piece: Uint8Array, last = false): ReceivedPacket[] {
    const bytes = joined(this.#rest, piece),
      found: ReceivedPacket[] = [];
    let offset = 0;
    while (!this.broken) {
      if (this.#isSearching) {
        const next = this.#search(bytes, offset);
        this.#skipped += next.at - offset;
        offset = next.at;
        this.#isSearching = !next.found;
        this.broken = this.#skipped > MAX_SKIPPED;
        if (!next.found) break;
      }
      const state = this.#readPacket(bytes, offset);
      if (typeof state === "object") {
        found.push({ order: FILE_ORDER, position: this.offset + offset, bytes: state });
        this.#damaged = this.#skipped = 0;
        offset += SIZE_BYTES + state.length;
      } else if ((state === "cut" && !last) || bytes.length - offset < SIZE_BYTES + HEADER_BYTES) break;
      else {
        this.#isSearching = true;
        this.broken = ++this.#damaged >= MAX_DAMAGED_IN_A_ROW;
        offset++;
        this.#skipped++;
      }
    }
    this.#rest = this.broken ? new Uint8Array() : bytes.slice(offset);
    this.offset += offset;
    return found;
  }

  /** Returns the intact packet at an index, or why there is none: incomplete or damaged. */
  #readPacket(bytes: Uint8Array, offset: number): Uint8Array | "cut" | "damaged" {
    const numLeft = bytes.length - offset;
    if (numLeft < SIZE_BYTES) return "cut";
    const size = dataView(bytes).getUint32(offset, true);
    if (size < HEADER_BYTES || size > this.#maxSize) return "damaged";
    const begins = this.#pattern.every((byte, n) => (bytes[offset + SIZE_BYTES + n] ?? byte) === byte);
    if (!begins) return "damaged";
    if (numLeft < SIZE_BYTES + size) return "cut";
    const packet = bytes.slice(offset + SIZE_BYTES, offset + SIZE_BYTES + size);
    return isIntact(packet, this.head) ? packet : "damaged";
  }

  /** Returns the index of the next size field before a possible packet, or of the last bytes that may belong to one. */
  #search(bytes: Uint8Array, from: number): { at: number; found: boolean } {
    const pattern = this.#pattern,
      end = bytes.length - pattern.length;
    for (
      let n = bytes.indexOf(PACKET_VERSION, from + SIZE_BYTES);
      n >= 0 && n <= end;
      n = bytes.indexOf(PACKET_VERSION, n + 1)
    )
      if (pattern.every((byte, k) => bytes[n + k] === byte)) return { at: n - SIZE_BYTES, found: true };
    return { at: Math.max(from, end + 1 - SIZE_BYTES), found: false };
  }
}

export class PacketReader {
  readonly #begin = new HeadReader();
  #scanner: PacketScanner | null;
  /** Number of intact packets. */
  numIntact = 0;
  /** The first intact packet. */
  first: ReceivedPacket | null = null;
  /** Number of bytes since the last new packet. */
  #repeated = 0;

  /**
   * Reads from the beginning of the file or, if `head` is given, from the packet at `offset`. `keep` is true if the
   * file can be cached.
   */
  constructor(
    readonly listener: Listener,
    readonly store: PacketStore,
    readonly keep: boolean,
    head: Head | null = null,
    offset = 0,
  ) {
    this.#scanner = head && new PacketScanner(head, offset);
  }

  get head(): Head | null {
    return this.#scanner?.head ?? null;
  }

  /** Offset and bytes of a head or packet that is not complete. */
  get begun(): { readonly offset: number; readonly bytes: Uint8Array } {
    return this.#scanner?.begun ?? { offset: 0, bytes: this.#begin.begun };
  }

  /** Adds bytes. Throws `Damaged` if the rest is unreadable. */
  feed(chunk: Uint8Array): void {
    for (let offset = 0; offset < chunk.length; offset += PIECE) this.#feed(chunk.subarray(offset, offset + PIECE));
  }

  /** Ends the data. Throws `Damaged` like `feed`. */
  finish(): void {
    if (this.#scanner) this.#take(this.#scanner.feed(new Uint8Array(), true));
  }

  #feed(piece: Uint8Array): void {
    let packets: Uint8Array | null = piece;
    if (!this.#scanner) {
      packets = afterHead(this.#begin, piece);
      const { head, headBytes } = this.#begin;
      if (!packets || !head) return;
      this.#scanner = new PacketScanner(head, headBytes.length);
      this.#report(head, headBytes);
    }
    this.#take(this.#scanner.feed(packets));
  }

  #take(packets: ReceivedPacket[]): void {
    this.numIntact += packets.length;
    this.first ??= packets[0] ?? null;
    const { count } = this.store;
    if (packets.length) this.listener.packets(packets);
    if (this.store.complete) return; // bytes after the last packet are ignored
    for (const { bytes } of packets) this.#repeated += SIZE_BYTES + bytes.length;
    if (this.store.count > count) this.#repeated = 0;
    if (this.#repeated > this.store.packetBytes + MAX_SKIPPED) throw new Damaged("the file repeats its packets");
    if (this.#scanner!.broken) throw new Damaged("the rest of the file is damaged");
  }

  #report(head: Head, fileHead: Uint8Array): void {
    const { store, listener } = this;
    if (store.hasHead && !store.isSame(fileHead)) {
      store.clear();
      listener.changed?.();
    }
    listener.head(head, fileHead, this.keep);
    listener.confirmed?.();
  }
}

/**
 * Returns the bytes after the head of a file. Throws `Damaged`, with the reason as its cause, if the head is invalid.
 */
function afterHead(begin: HeadReader, piece: Uint8Array): Uint8Array | null {
  try {
    return begin.feed(piece);
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
    throw new Damaged(error.message, { cause: error });
  }
}
