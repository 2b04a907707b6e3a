// The receiving side of one transfer: bytes and time (milliseconds) in, bytes out; no socket, no clock.

import { hex } from "../bytes.ts";
import type { Look } from "../codec/levels/cut.ts";
import type { Head } from "../packets/container.ts";
import { readPacket } from "../packets/packet.ts";
import type { Arrived } from "./events.ts";
import {
  BY_SEQUENCE,
  DATA,
  END,
  kindOf,
  REFUSE,
  readWelcome,
  SIDE,
  viewOf,
  WELCOME,
  type Welcome,
  writeBye,
  writeFeedback,
  writeHave,
  writeRequest,
  writeView,
} from "./frames.ts";
import { HeadObject } from "./head_object.ts";

const REFUSALS = [
  "",
  "no such stream",
  "the server is full",
  "the server stopped",
  "too many transfers from this network",
];
const IMPOSSIBLE = "the server announces something impossible";
/** Reasons of a server that no further attempt changes. */
export const FINAL_REFUSALS: readonly string[] = [REFUSALS[1], IMPOSSIBLE];
/** The one reason after which it is asked again: a live clip that has not begun. */
const NOT_YET = 5;
const AGAIN_MS = 120,
  REORDER = 48,
  MOST_EARLY = 64,
  MOST_NEWER = 512,
  MOST_NACKS = 250,
  MOST_AHEAD = 2 ** 17,
  ENDS_IN_VAIN = 25,
  MOST_GAPS = 4096,
  TRIES = 8;

/** What there is of a stream from before. */
export interface Before {
  readonly head: Head;
  /** A bit for each packet by its place, the lowest of a byte first. */
  readonly held: Uint8Array;
}

export class Transfer {
  welcome: Welcome | null = null;
  head: Head | null = null;
  /** Packets that were not taken away yet. */
  fresh: Arrived[] = [];
  /** Why it is over. */
  finished: string | null = null;
  headMs: number | null = null;
  /** How many heads came: a stream that grows has one for each group of frames. */
  heads = 0;
  readonly counts = { bytes: 0, datagrams: 0, rejected: 0, duplicates: 0, packets: 0, packetBytes: 0 };
  readonly #request: Uint8Array;
  #object: HeadObject | null = null;
  /** Whether each packet is there: 1, or 2 for one that nobody asks for any more. */
  #there = new Uint8Array();
  readonly #asked = new Map<number, number>();
  readonly #tries = new Map<number, number>();
  #streamBefore: number | null = null;
  #largest = -1;
  #largestAt: number;
  #highest = -1;
  #lowest = 0;
  /** Whether everything was sent, or all that somebody looks at, as far as the server knows where. */
  ended = false;
  /** Where somebody looks from was said: what comes is what they see, and asked for again by its number. */
  viewing = false;
  readonly #gaps = new Map<number, number>();
  #said = 0;
  #endsInVain = 0;
  /** What overtook the welcome, and packets that overtook one that says more. */
  #early: Uint8Array[] = [];
  #ahead: Arrived[] = [];

  constructor(
    readonly name: string,
    readonly nonce: bigint,
    readonly began: number,
    readonly before: Before | null = null,
  ) {
    this.#largestAt = began;
    this.#request = writeRequest(nonce, name);
  }

  request(): Uint8Array {
    return this.#request;
  }

  /** What is said behind the request: what need not be sent. */
  have(): Uint8Array[] {
    return this.before ? writeHave(this.nonce, this.before.head.manifest.streamId, this.before.held) : [];
  }

  /** Whether it goes on with what there was; known once there is a welcome. */
  get goesOn(): boolean {
    return this.welcome !== null && this.welcome.streamId === this.before?.head.manifest.streamId;
  }

  /** Datagrams that the server sent and that never came, as far as their numbers tell. */
  get datagramsLost(): number {
    return Math.max(this.#largest + 1 - this.counts.datagrams, 0);
  }

  /** The stream's file up to its first packet; once the head came. */
  get fileHead(): Uint8Array {
    return this.#object!.file(this.head!);
  }

  /** SHA-256 of the head object, hexadecimal; empty as long as it is not there. */
  get headDigest(): string {
    return this.head && this.#object ? this.#object.digest : "";
  }

  receive(bytes: Uint8Array, now: number): void {
    if (this.finished) return;
    const kind = kindOf(bytes);
    this.counts.bytes += bytes.length;
    if (kind === WELCOME && !this.welcome) return this.#welcomed(bytes, now);
    if (kind === WELCOME) return this.#told(bytes, now);
    if (kind === REFUSE && bytes[9] === NOT_YET) return;
    if (kind === REFUSE && !this.welcome) return void (this.finished = REFUSALS[bytes[9]] || "the server refused");
    const known =
      kind === SIDE ? bytes.length > 19 : kind === DATA ? bytes.length > 13 : kind === END && bytes.length > 9;
    if (!this.welcome && known && this.#early.length < MOST_EARLY) return void this.#early.push(bytes);
    if (!this.welcome || !known || viewOf(bytes).getUint32(1, true) !== this.welcome.session)
      return void this.counts.rejected++;
    if (kind === SIDE) return this.#side(bytes, now);
    const sequence = viewOf(bytes).getUint32(5, true);
    if (sequence > this.#largest + MOST_AHEAD) return void this.counts.rejected++;
    this.counts.datagrams++;
    if (this.welcome.viewable) this.#count(sequence);
    if (sequence > this.#largest) [this.#largest, this.#largestAt] = [sequence, now];
    if (kind === END) {
      this.ended = true;
      this.#endsInVain++;
    } else {
      this.#endsInVain = 0;
      if (this.viewing) this.ended = false;
      const place = viewOf(bytes).getUint32(9, true);
      this.#take(place, bytes.slice(13), true);
      if (this.#there[place]) this.#highest = Math.max(this.#highest, place);
    }
    this.#look();
  }

  /** Tells where somebody looks from. */
  view(look: Look, budget: number): Uint8Array {
    this.viewing = true;
    return writeView(this.welcome!.session, ++this.#said, look, budget);
  }

  /** Notes which numbers before this one did not come. */
  #count(sequence: number): void {
    this.#gaps.delete(sequence);
    for (let n = Math.max(this.#largest + 1, sequence - MOST_GAPS); n < sequence; n++) this.#gaps.set(n, 0);
    for (const old of this.#gaps.keys()) {
      if (this.#gaps.size <= MOST_GAPS) break;
      this.#gaps.delete(old);
    }
  }

  /** Numbers that did not come; each is asked for a few times, since nobody hears whether a question came. */
  #lostNumbers(now: number): number[] {
    const before = this.ended ? this.#largest : this.#largest - REORDER,
      lost: number[] = [];
    for (const [number, times] of this.#gaps) {
      if (number > before || lost.length === MOST_NACKS) break;
      const asked = BY_SEQUENCE + number;
      if (now - (this.#asked.get(asked) ?? -1e9) < AGAIN_MS) continue;
      if (times === TRIES) {
        this.#gaps.delete(number);
        this.#asked.delete(asked);
        continue;
      }
      this.#gaps.set(number, times + 1);
      this.#asked.set(asked, now);
      lost.push(asked);
    }
    return lost;
  }

  /** Places of packets that should have come. */
  #lostPlaces(now: number): number[] {
    const { packets, carried } = this.welcome!,
      lost: number[] = [];
    const stop = this.ended ? packets : this.#highest + 1 - REORDER;
    const { open } = this.welcome!;
    while (this.#lowest < packets && this.#there[this.#lowest]) this.#lowest++;
    for (
      let place = this.head ? this.#lowest : Math.max(carried, this.#lowest);
      place < stop && lost.length < MOST_NACKS;
      place++
    ) {
      if (this.#there[place] || now - (this.#asked.get(place) ?? -1e9) < AGAIN_MS) continue;
      const tries = this.#tries.get(place) ?? 0;
      if (open && tries === TRIES) {
        this.#there[place] = 2; // what moves is worth nothing once its time has passed
        continue;
      }
      this.#tries.set(place, tries + 1);
      this.#asked.set(place, now);
      lost.push(place);
    }
    return lost;
  }

  feedback(now: number): Uint8Array {
    return writeFeedback({
      session: this.welcome!.session,
      largest: Math.max(this.#largest, 0),
      received: Math.min(this.counts.datagrams, this.#largest + 1),
      clock: Math.round(this.#largestAt * 1000),
      symbolsMissing: this.head ? 0 : (this.#object?.missing ?? 0),
      lost: this.viewing ? this.#lostNumbers(now) : this.#lostPlaces(now),
    });
  }

  bye(): Uint8Array {
    return writeBye(this.welcome!.session);
  }

  #welcomed(bytes: Uint8Array, now: number): void {
    const welcome = readWelcome(bytes, this.nonce);
    if (!welcome) return void (this.finished = IMPOSSIBLE);
    this.welcome = welcome;
    this.#object = new HeadObject(welcome);
    this.#there = new Uint8Array(welcome.packets);
    if (this.before && this.goesOn) {
      const { head, held } = this.before;
      if (head.manifest.numPackets !== welcome.packets) return void (this.finished = "the stream has grown");
      this.head = head;
      for (let place = 0; place < welcome.packets; place++) this.#there[place] = (held[place >> 3] >> (place & 7)) & 1;
      this.counts.packets = this.#there.reduce((sum, one) => sum + one, 0);
      this.#look();
    }
    this.#again(now);
  }

  /** What there is by now of a stream that grows, or the one that follows it; anything else came twice. */
  #told(bytes: Uint8Array, now: number): void {
    const before = this.welcome!,
      next = readWelcome(bytes, this.nonce);
    if (!next || !before.open || next.session !== before.session) return;
    const same = next.streamId === before.streamId;
    if (same ? next.packets < before.packets : next.streamId === this.#streamBefore) return;
    if (same && next.open === before.open && hex(next.digest) === hex(before.digest)) return;
    this.welcome = next;
    this.#object = new HeadObject(next);
    this.head = null;
    this.ended = false;
    this.#endsInVain = 0;
    const there = new Uint8Array(next.packets);
    if (same) there.set(this.#there);
    else this.#leave(before.streamId);
    this.#there = there;
    this.#again(now);
  }

  /** Forgets what was of another stream. */
  #leave(streamId: number): void {
    this.#streamBefore = streamId;
    this.#asked.clear();
    this.#tries.clear();
    this.#highest = -1;
    this.#lowest = this.counts.packets = 0;
    this.fresh = [];
  }

  /** Takes what overtook a welcome. */
  #again(now: number): void {
    for (const early of this.#early.splice(0)) {
      this.counts.bytes -= early.length; // it was counted when it came
      this.receive(early, now);
    }
    for (const { place, bytes } of this.#ahead.splice(0)) this.#take(place, bytes);
  }

  #side(bytes: Uint8Array, now: number): void {
    if (this.head) return; // it was there before
    if (!this.#object!.add(bytes)) return void this.counts.rejected++;
    if (this.#object!.missing) return;
    this.headMs ??= now - this.began;
    try {
      const { head, carried } = this.#object!.read();
      this.head = head;
      this.heads++;
      carried.forEach((packet, place) => this.#take(place, packet));
      this.#look();
    } catch (error) {
      this.finished = (error as Error).message;
    }
  }

  /** Takes a packet; of a stream that grows it `may` be ahead of the welcome that tells of it. */
  #take(place: number, packet: Uint8Array, may = false): void {
    const { packets, packetBytes, streamId, open } = this.welcome!;
    if (place >= packets || packet.length > packetBytes || !readPacket(packet, streamId)) {
      if (open && may && this.#ahead.length < MOST_NEWER) this.#ahead.push({ place, bytes: packet });
      else this.counts.rejected++;
      return;
    }
    if (this.#there[place] === 1) return void this.counts.duplicates++;
    this.#there[place] = 1;
    this.fresh.push({ place, bytes: packet });
    this.counts.packets++;
    this.counts.packetBytes += packet.length;
  }

  #look(): void {
    if (!this.head || this.welcome!.open) return;
    if (this.counts.packets === this.welcome!.packets) this.finished = "complete";
    else if (!this.viewing && this.#endsInVain >= ENDS_IN_VAIN) this.finished = "sent";
  }
}
