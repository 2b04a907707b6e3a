// Received packets of a stream by block and index in it, with their positions in the file and in the orders of
// sessions. Only missing packets are requested.

import type { Head } from "../packets/container.ts";
import { identityOf, readPacket } from "../packets/packet.ts";
import { Intake, planOf } from "../packets/plan.ts";
import { FILE_ORDER, type ReceivedPacket, UNKNOWN_ORDER } from "./events.ts";

/** Bytes of a packet's size field in a file. */
export const SIZE_BYTES = 4;
/** Bytes of a file before its manifest. */
const PREFIX_BYTES = 9;
/** Largest number of session orders with stored positions. */
const MAX_ORDERS = 2;

/** A run of bytes of the file without known packets. */
export interface Gap {
  /** Offset of its first byte, where a packet begins. */
  readonly offset: number;
  /** Offset after its last byte; null for the end of the file. */
  readonly end: number | null;
  /** Offset of the packet before it, which is used to verify the file's order; null before the first packet. */
  readonly before: number | null;
}

/** Parses the packet. Returns null if its checksum is wrong or it belongs to another stream. */
export function packetOf(bytes: Uint8Array, { manifest }: Head): ReturnType<typeof readPacket> {
  const packet = readPacket(bytes, manifest.streamId);
  return packet && planOf(manifest).fits(packet) ? packet : null;
}

/** Returns true if the packet is intact and belongs to the stream. */
export function isIntact(packet: Uint8Array, head: Head): boolean {
  return packetOf(packet, head) !== null;
}

export class PacketStore {
  /** Manifest and side information; null before their arrival. */
  head: Head | null = null;
  #fileHead: Uint8Array = new Uint8Array();
  #intake: Intake | null = null;
  /** Bytes of each received packet by its identity. */
  readonly #packets = new Map<number, ReceivedPacket>();
  #map = new FileMap();
  /** True if the file has another order than assumed. */
  #isOwnOrder = false;
  /** Packet identities by position, for each session order. */
  readonly #orders = new Map<string, (number | undefined)[]>();
  /** Number of intact packets that contradict stored ones, as after a change of the stream. */
  conflicts = 0;
  /** Size of the received packets in a file, bytes. */
  packetBytes = 0;

  /** Number of received packets. */
  get count(): number {
    return this.#intake?.size ?? 0;
  }

  /** Bytes of the file before its first packet. */
  get headSize(): number {
    return this.#fileHead.length;
  }

  get hasHead(): boolean {
    return this.head !== null;
  }

  /** True if all packets were received. */
  get complete(): boolean {
    return this.#intake?.complete ?? false;
  }

  /** First bytes of the file up to the end of its manifest. They identify the content. */
  get manifestBytes(): Uint8Array {
    return this.#fileHead.subarray(0, this.#fileHead.length - (this.head?.sideInfo.length ?? 0));
  }

  /** Init segment without bundled packets: manifest and side information. */
  get initSegment(): Uint8Array {
    return this.#fileHead.subarray(PREFIX_BYTES - SIZE_BYTES);
  }

  /** Returns true if a file that begins with these bytes, at least up to its first packet, is the stored one. */
  isSame(firstBytes: Uint8Array): boolean {
    const stored = this.manifestBytes;
    return stored.length > PREFIX_BYTES && isEqual(stored, firstBytes.subarray(0, stored.length));
  }

  /** Starts again with a file up to its first packet. */
  begin(fileHead: Uint8Array, head: Head): void {
    this.clear();
    this.head = head;
    this.#fileHead = fileHead;
    this.#intake = new Intake(planOf(head.manifest));
  }

  clear(): void {
    this.head = this.#intake = null;
    this.#fileHead = new Uint8Array();
    this.#packets.clear();
    this.#orders.clear();
    this.#map = new FileMap();
    this.#isOwnOrder = false;
    this.conflicts = this.packetBytes = 0;
  }

  /** Adds packets with their positions. Returns the new ones and ignores damaged ones. */
  add(packets: readonly ReceivedPacket[]): ReceivedPacket[] {
    const { head } = this,
      added: ReceivedPacket[] = [];
    if (!head) return added;
    for (const received of packets) {
      const packet = packetOf(received.bytes, head);
      if (!packet) continue;
      const identity = identityOf(packet),
        stored = this.#packets.get(identity);
      if (!stored && this.#intake!.admit(packet)) {
        this.#packets.set(identity, received);
        this.packetBytes += SIZE_BYTES + received.bytes.length;
        added.push(received);
      } else if (!stored || !isEqual(stored.bytes, received.bytes)) {
        this.conflicts++;
        continue;
      }
      this.#locate(received, identity);
    }
    return added;
  }

  #locate({ order, position, bytes }: ReceivedPacket, identity: number): void {
    if (order === FILE_ORDER) return this.#map.add(position, SIZE_BYTES + bytes.length, identity);
    if (order === UNKNOWN_ORDER || position >= this.head!.manifest.numPackets) return;
    let identities = this.#orders.get(order);
    if (!identities) this.#orders.set(order, (identities = []));
    identities[position] = identity;
    for (const old of this.#orders.keys()) if (this.#orders.size > MAX_ORDERS) this.#orders.delete(old);
  }

  /** All received packets. */
  get packets(): ReceivedPacket[] {
    return [...this.#packets.values()];
  }

  /**
   * Returns one bit per received packet in a session's order, the lowest bit of a byte first. Returns null if the order
   * is unknown or has a packet twice.
   */
  bitsOf(order: string): Uint8Array | null {
    const identities = this.#orders.get(order);
    if (!identities) return null;
    const bits = new Uint8Array(Math.ceil(identities.length / 8)),
      distinct = new Set<number>();
    identities.forEach((identity, position) => {
      distinct.add(identity!);
      bits[position >> 3] |= 1 << (position & 7);
    });
    return distinct.size === identities.filter((identity) => identity !== undefined).length ? bits : null;
  }

  /** True if known packets of the file overlap, because its order has changed since some were read. */
  get isReordered(): boolean {
    return this.#map.contradicts;
  }

  /** Returns true if the packet is the one stored at an offset of the file. */
  isAt(offset: number, bytes: Uint8Array): boolean {
    const packet = this.head && packetOf(bytes, this.head);
    return packet !== null && this.#map.identityAt(offset) === identityOf(packet);
  }

  /** Discards the positions of packets in the file but keeps the packets. */
  forgetOffsets(): void {
    this.#map = new FileMap();
    this.#isOwnOrder = true;
  }

  /** Returns the byte ranges of the file that may contain missing packets, in order. */
  get gaps(): Gap[] {
    if (!this.head || this.complete) return [];
    if (this.#map.isEmpty && !this.#isOwnOrder) this.#assumeOrder();
    return this.#map.gaps(this.headSize);
  }

  /**
   * Predicts offsets in a file that has a session's order, up to the first missing packet. The packet before each gap
   * verifies the prediction.
   */
  #assumeOrder(): void {
    const order = [...this.#orders.values()].at(-1) ?? [];
    let offset = this.headSize;
    for (const identity of order) {
      const packet = identity === undefined ? undefined : this.#packets.get(identity);
      if (!packet) break;
      const size = SIZE_BYTES + packet.bytes.length;
      this.#map.add(offset, size, identity!);
      offset += size;
    }
  }
}

function isEqual(a: Uint8Array, b: Uint8Array): boolean {
  return a.length === b.length && a.every((byte, n) => byte === b[n]);
}

/** Offsets of the packets in a file. */
class FileMap {
  readonly #sizes = new Map<number, { readonly size: number; readonly identity: number }>();
  readonly #offsets = new Map<number, number>();
  contradicts = false;

  get isEmpty(): boolean {
    return this.#sizes.size === 0;
  }

  /** Records a packet of `size` bytes, including its size field. */
  add(offset: number, size: number, identity: number): void {
    const stored = this.#sizes.get(offset);
    this.contradicts ||= (this.#offsets.get(identity) ?? offset) !== offset;
    this.contradicts ||= stored !== undefined && (stored.size !== size || stored.identity !== identity);
    this.#sizes.set(offset, { size, identity });
    this.#offsets.set(identity, offset);
  }

  identityAt(offset: number): number | undefined {
    return this.#sizes.get(offset)?.identity;
  }

  gaps(begin: number): Gap[] {
    const gaps: Gap[] = [];
    let offset = begin,
      before: number | null = null;
    for (const next of [...this.#sizes.keys()].sort((a, b) => a - b)) {
      if (next > offset) gaps.push({ offset, end: next, before });
      this.contradicts ||= next < offset;
      before = next;
      offset = Math.max(offset, next + this.#sizes.get(next)!.size);
    }
    return [...gaps, { offset, end: null, before }];
  }
}
