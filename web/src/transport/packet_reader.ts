// Packets out of the bytes of a file as they come: verified ones are handed on, damaged ones are counted and left out.

import { BitstreamError } from "../bytes.ts";
import { ContainerReader, type Head } from "../packets/container.ts";
import { readPacket } from "../packets/packet.ts";
import type { Arrived, Listener } from "./events.ts";
import type { Held } from "./held.ts";

/** Bytes that are parsed at once: a browser hands over everything that waited for a busy thread. */
const PIECE = 1 << 16;
/** Damaged packets in a row after which the sizes of packets cannot be right either. */
const MAX_DAMAGED_IN_A_ROW = 8;

/** Bytes that are not those of the stream: damaged on the way or on the server, or of a file that was replaced. */
export class Damaged extends Error {}

/** Returns True if the checksum of a packet holds and it belongs to the stream. */
export function isIntact(packet: Uint8Array, head: Head): boolean {
  return readPacket(packet, head.manifest.streamId) !== null;
}

export class PacketReader {
  readonly #container: ContainerReader;
  /** Damaged packets since the last intact one. */
  #suspects: Arrived[] = [];
  #told: boolean;
  /** Number of intact packets. */
  intact = 0;

  /**
   * Reads from the file's beginning or, where the `head` is known, from the packet at `place` on. `keep`: the file will
   * be the same later.
   */
  constructor(
    readonly listener: Listener,
    readonly held: Held,
    readonly keep: boolean,
    head: Head | null = null,
    private place = 0,
  ) {
    this.#container = new ContainerReader(head);
    this.#told = head !== null;
  }

  get head(): Head | null {
    return this.#container.head;
  }

  /** Takes bytes. Throws `Damaged` where nothing behind them can be read. */
  feed(chunk: Uint8Array): void {
    for (let at = 0; at < chunk.length; at += PIECE) this.#feed(chunk.subarray(at, at + PIECE));
  }

  #feed(piece: Uint8Array): void {
    const container = this.#container,
      found = parsed(container, piece),
      { head } = container,
      intact: Arrived[] = [];
    if (!head) return;
    if (!this.#told) this.#begin(head);
    for (const bytes of found) {
      const packet = { place: this.place++, bytes };
      if (packet.place >= head.manifest.numPackets) break;
      if (!isIntact(bytes, head)) {
        this.#suspects.push(packet);
        if (this.#suspects.length >= MAX_DAMAGED_IN_A_ROW) break;
        continue;
      }
      for (const suspect of this.#suspects.splice(0)) this.held.noteSize(suspect.place, suspect.bytes.length);
      intact.push(packet);
    }
    this.intact += intact.length;
    if (intact.length) this.listener.packets(intact);
    if (this.held.complete) return; // whatever is behind the last packet
    if (container.broken || this.#suspects.length >= MAX_DAMAGED_IN_A_ROW)
      throw new Damaged("the rest of the file is damaged");
  }

  #begin(head: Head): void {
    const { held, listener } = this,
      file = this.#container.headBytes;
    this.#told = true;
    if (held.begun && !held.isSame(file)) {
      held.clear();
      listener.changed?.();
    }
    listener.head(head, file, this.keep);
    listener.confirmed?.();
  }
}

/** Packets that are complete now. Throws `Damaged`, with the reason as its cause, where the file's head is none. */
function parsed(container: ContainerReader, piece: Uint8Array): Uint8Array[] {
  try {
    return container.feed(piece);
  } catch (error) {
    if (!(error instanceof BitstreamError)) throw error;
    throw new Damaged(error.message, { cause: error });
  }
}
