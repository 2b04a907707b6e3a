// What of a stream's file is there, so that an attempt after the first asks for the rest only.

import type { Arrived } from "./events.ts";

/** Bytes before the rest that are asked for once more: where they differ, the file is another one by now. */
const TAIL = 64;

/** Where the rest of a file begins. */
export interface Rest {
  /** Place of the first packet that is lacking. */
  readonly place: number;
  readonly offset: number;
  /** The last bytes before it. */
  readonly tail: Uint8Array;
}

export class Held {
  #head: Uint8Array | null = null;
  #packets: (Uint8Array | undefined)[] = [];
  #first = 0;
  #offset = 0;
  /** Packets that are there. */
  count = 0;

  /** Bytes of the file up to its first packet. */
  get headBytes(): number {
    return this.#head?.length ?? 0;
  }

  get begun(): boolean {
    return this.#head !== null;
  }

  /** Begins with the bytes of a file up to its first packet. */
  begin(head: Uint8Array): void {
    this.clear();
    this.#head = head;
    this.#offset = head.length;
  }

  clear(): void {
    this.#head = null;
    this.#packets = [];
    this.#first = this.#offset = this.count = 0;
  }

  /** Takes packets by their places in the file; those that are new. */
  add(packets: readonly Arrived[]): Arrived[] {
    const fresh = packets.filter(({ place, bytes }) => {
      if (this.#packets[place]) return false;
      this.#packets[place] = bytes;
      return true;
    });
    this.count += fresh.length;
    for (let next = this.#packets[this.#first]; next; next = this.#packets[++this.#first]) {
      this.#offset += 4 + next.length;
    }
    return fresh;
  }

  /** A bit for each packet, the lowest of a byte first. */
  get bits(): Uint8Array {
    const bits = new Uint8Array(Math.ceil(this.#packets.length / 8));
    this.#packets.forEach((packet, place) => {
      if (packet) bits[place >> 3] |= 1 << (place & 7);
    });
    return bits;
  }

  /** From the first gap on; null where there is no head yet. */
  get rest(): Rest | null {
    if (!this.#head) return null;
    const last = this.#packets[this.#first - 1] ?? this.#head;
    return { place: this.#first, offset: this.#offset, tail: last.subarray(-TAIL) };
  }
}
