// The held packets of a stream's file, so that only the missing ones are requested.

import type { Head } from "../packets/container.ts";
import type { Arrived } from "./events.ts";

/** Bytes of a packet's size field in the file. */
const SIZE_BYTES = 4;
/** Bytes of a file before its manifest. */
const PREFIX_BYTES = 9;

/** A run of missing packets whose offset in the file is known. */
export interface Gap {
  /** Index of the first missing packet. */
  readonly place: number;
  /** Offset of its size field, bytes. */
  readonly offset: number;
  /** Offset behind the last missing packet; null where a size in between is not known. */
  readonly end: number | null;
}

export class Held {
  /** Manifest and side information; null before they arrived. */
  head: Head | null = null;
  #file: Uint8Array = new Uint8Array();
  #packets: (Uint8Array | undefined)[] = [];
  /** Sizes of packets by place, also of damaged ones whose size is certain. */
  #sizes: (number | undefined)[] = [];
  /** Number of held packets. */
  count = 0;

  /** Bytes of the file up to its first packet. */
  get headBytes(): number {
    return this.#file.length;
  }

  get begun(): boolean {
    return this.head !== null;
  }

  /** True if all packets are held. */
  get complete(): boolean {
    return this.head !== null && this.count === this.head.manifest.numPackets;
  }

  /** First bytes of the file, up to the end of its manifest: no other content begins with the same ones. */
  get manifestBytes(): Uint8Array {
    return this.#file.subarray(0, this.#file.length - (this.head?.sideInfo.length ?? 0));
  }

  /** Returns True if a file that begins with these bytes, at least up to its first packet, is the one that is held. */
  isSame(file: Uint8Array): boolean {
    const known = this.manifestBytes;
    return known.length > PREFIX_BYTES && known.length <= file.length && known.every((byte, n) => byte === file[n]);
  }

  /** Starts again with the bytes of a file up to its first packet. */
  begin(file: Uint8Array, head: Head): void {
    this.clear();
    this.head = head;
    this.#file = file;
  }

  clear(): void {
    this.head = null;
    this.#file = new Uint8Array();
    this.#packets = [];
    this.#sizes = [];
    this.count = 0;
  }

  /** Takes verified packets by their places in the file; returns the new ones. */
  add(packets: readonly Arrived[]): Arrived[] {
    const fresh = packets.filter(({ place, bytes }) => {
      if (this.#packets[place]) return false;
      this.#packets[place] = bytes;
      this.#sizes[place] = bytes.length;
      return true;
    });
    this.count += fresh.length;
    return fresh;
  }

  /** Notes the size of a damaged packet, so that the offsets behind it are known. */
  noteSize(place: number, size: number): void {
    this.#sizes[place] ??= size;
  }

  /** All held packets. */
  get packets(): Arrived[] {
    return this.#packets.flatMap((bytes, place) => (bytes ? [{ place, bytes }] : []));
  }

  /** A bit for each packet, the lowest of a byte first. */
  get bits(): Uint8Array {
    const bits = new Uint8Array(Math.ceil(this.#packets.length / 8));
    this.#packets.forEach((packet, place) => {
      if (packet) bits[place >> 3] |= 1 << (place & 7);
    });
    return bits;
  }

  /** Runs of missing packets, as far as offsets are known. */
  get gaps(): Gap[] {
    const found: Gap[] = [],
      numPackets = this.head?.manifest.numPackets ?? 0;
    let offset = this.headBytes,
      first: { place: number; offset: number } | null = null;
    for (let place = 0; place < numPackets; place++) {
      const size = this.#sizes[place];
      if (this.#packets[place]) {
        if (first) found.push({ ...first, end: offset });
        first = null;
      } else {
        first ??= { place, offset };
      }
      if (size === undefined) break;
      offset += SIZE_BYTES + size;
    }
    return first ? [...found, { ...first, end: null }] : found;
  }
}
