// Receiver state machine of one WebTransport session. Maps received bytes and times (milliseconds) to bytes to send. It
// has no socket and no clock. `splatwire.transport.protocol` describes the limits of requests (NACKs), in `nack`,
// `gap_tracker` and `receiver`.

import { hex } from "../bytes.ts";
import type { ViewCamera } from "../codec/levels/cut.ts";
import type { Head } from "../packets/container.ts";
import { identityOf, readPacket } from "../packets/packet.ts";
import { sha256 } from "../sha256.ts";
import { type ReceivedPacket, UNKNOWN_ORDER } from "./events.ts";
import { InitSegment } from "./init_segment.ts";
import {
  DATA,
  END,
  INIT_SYMBOL,
  MAX_FRUITLESS_ENDS,
  MAX_GAPS,
  MAX_NACK_ATTEMPTS,
  MAX_NACKS,
  MAX_SEQUENCE_JUMP,
  NACK_INTERVAL_MS,
  NOT_YET,
  OTHER_VERSION,
  PARITY,
  REFUSALS,
  REFUSE,
  REORDER_THRESHOLD,
  WELCOME,
} from "./wire.ts";
import {
  dataView,
  messageKind,
  readWelcome,
  type Welcome,
  writeBye,
  writeFeedback,
  writeHave,
  writeRequest,
  writeViewUpdate,
} from "./wire_messages.ts";

const IMPOSSIBLE = "the server announces something impossible";
/** Delay between requests for a live stream that has not begun, milliseconds. */
const NOT_YET_MS = 250;
/** Refusals that a retry cannot resolve. */
export const FINAL_REFUSALS: readonly string[] = [REFUSALS[1], REFUSALS[OTHER_VERSION], IMPOSSIBLE];
/** Maximum number of datagrams kept until the welcome message arrives. */
const MAX_EARLY_DATAGRAMS = 64;
/** Maximum number of packets kept until the message arrives that announces them. */
const MAX_WAITING_PACKETS = 512;
/** Maximum number of packets kept until the head arrives. Further ones are requested again. */
const MAX_PACKETS_BEFORE_HEAD = 16_384;
/** Minimum time between counted `End` datagrams, milliseconds: after an outage, many may arrive at once. */
const MIN_END_SPACING_MS = 50;

/** Number of contradicting packets after which the transfer ends. */
const MAX_CONTRADICTIONS = 64;

/** A stream with some stored packets. */
export interface StoredStream {
  readonly head: Head;
  /** Init segment without bundled packets. */
  readonly initSegment: Uint8Array;
  /**
   * Returns one bit per stored packet in an order (`Welcome.orderDigest`), the lowest bit of a byte first; null for
   * unknown orders.
   */
  bitsOf(orderDigest: string): Uint8Array | null;
}

export class Transfer {
  welcome: Welcome | null = null;
  head: Head | null = null;
  /** Received packets that the caller has not taken yet. */
  newPackets: ReceivedPacket[] = [];
  /** How the transfer ended; null while it continues. */
  finished: string | null = null;
  initSegmentMs: number | null = null;
  /** Number of received heads. A growing stream has one per group of frames. */
  numInitSegments = 0;
  /** Last welcome message of the reliable stream. */
  #welcomeOnStream: Welcome | null = null;
  /** True after a later welcome message that differs: with another init segment, or the final one. */
  #isGrown = false;
  /** Number of later welcome messages since the last head. */
  #numWelcomesSinceHead = 0;
  readonly counts = { bytes: 0, datagrams: 0, rejected: 0, duplicates: 0, packets: 0, receivedPacketBytes: 0 };
  /** Time until which the request is not repeated, because a live stream has not begun. */
  waitUntil = 0;
  readonly #request: Uint8Array;
  #initSegment: InitSegment | null = null;
  /** State of each packet: 0 missing, 1 received, 2 given up. */
  #packetStates = new Uint8Array();
  /** Times of requests by packet index. */
  readonly #packetNackedAt = new Map<number, number>();
  readonly #nackCounts = new Map<number, number>();
  /** True if the stream was live when the transfer began. The requests for each packet are then limited. */
  #beganLive = false;
  /** Stream id of the previous period. Its late welcome messages are ignored. */
  #previousPeriodId: number | null = null;
  #largestSequence = -1;
  #largestAt: number;
  #highestReceived = -1;
  #lowestMissing = 0;
  /** True once the server has sent everything so far, or all tiles of the view. */
  isAllSent = false;
  /**
   * True once a view was sent. The server then sends its tiles, and lost datagrams are requested by sequence number.
   */
  hasSentView = false;
  /** Missing sequence numbers, with the number and the time (milliseconds) of their requests. */
  readonly #gaps = new Map<number, { requests: number; requestedAt: number }>();
  #numViewUpdates = 0;
  #fruitlessEnds = 0;
  #endCountedAt = 0;
  /**
   * Datagrams that arrived before the welcome message, and packets that arrived before the message that announces them.
   */
  #earlyDatagrams: Uint8Array[] = [];
  #waitingPackets: { readonly index: number; readonly bytes: Uint8Array }[] = [];
  /** True if the stream is that of the stored packets, false if not, null as long as unknown. */
  isSameStream: boolean | null = null;
  /** Messages that announce the stored packets; empty once sent. */
  #haveMessages: Uint8Array[] = [];
  /** Position of each packet by its identity, and the reverse. */
  readonly #indexOfIdentity = new Map<number, number>();
  readonly #identityOfIndex = new Map<number, number>();
  #contradictions = 0;

  constructor(
    readonly name: string,
    readonly nonce: bigint,
    readonly began: number,
    readonly before: StoredStream | null = null,
  ) {
    this.#largestAt = began;
    this.#request = writeRequest(nonce, name);
  }

  request(): Uint8Array {
    return this.#request;
  }

  /** Returns the messages that announce stored packets, once, after a welcome message with their order. */
  takeHaveMessages(): Uint8Array[] {
    return this.#haveMessages.splice(0);
  }

  /** Number of datagrams lost on the path, according to their sequence numbers. */
  get datagramsLost(): number {
    return Math.max(this.#largestSequence + 1 - this.counts.datagrams, 0);
  }

  /**
   * Number that changes when something new arrives. If the server may have nothing new to send, any later datagram
   * counts as new. After two later welcome messages without a head it stays 0. Before the first welcome it contains
   * 0.5, which differs from every number of missing symbols.
   */
  get activity(): number {
    if (this.#numWelcomesSinceHead > 1) return 0;
    return this.counts.packets - (this.#initSegment?.missing ?? 0.5) + (this.mayIdle ? this.#largestSequence : 0);
  }

  /** True if the server may have nothing new to send: for a view, or in a live stream. */
  get mayIdle(): boolean {
    return this.head !== null && (this.hasSentView || this.welcome!.isLive);
  }

  /** Stream's file up to its first packet. Valid once the head arrived. */
  get fileHead(): Uint8Array {
    return this.#initSegment!.fileHead(this.head!);
  }

  /**
   * Processes a message. `isDatagram` is false for messages of the reliable stream. They arrive in order, and the first
   * ones also arrive as datagrams.
   */
  receive(bytes: Uint8Array, now: number, isDatagram = true): void {
    if (this.finished) return;
    const kind = messageKind(bytes);
    this.counts.bytes += bytes.length;
    if (kind === WELCOME && !isDatagram) this.#welcomeOnStream = readWelcome(bytes, this.nonce);
    if (kind === INIT_SYMBOL && this.#isOfEarlierSegment(isDatagram)) return;
    if (kind === WELCOME && !this.welcome) return this.#onWelcome(bytes, now);
    if (kind === WELCOME) return this.#onLaterWelcome(bytes, now);
    if (kind === REFUSE && bytes[9] === NOT_YET) return void (this.waitUntil = now + NOT_YET_MS);
    if (kind === REFUSE && !this.welcome) return void (this.finished = REFUSALS[bytes[9]] || "the server refused");
    const isValid =
      kind === INIT_SYMBOL || kind === PARITY
        ? bytes.length > 19
        : kind === DATA
          ? bytes.length > 13
          : kind === END && bytes.length > 9;
    if (!this.welcome && isValid && this.#earlyDatagrams.length < MAX_EARLY_DATAGRAMS)
      return void this.#earlyDatagrams.push(bytes);
    if (!this.welcome || !isValid || dataView(bytes).getUint32(1, true) !== this.welcome.session)
      return void this.counts.rejected++;
    if (kind === INIT_SYMBOL) return this.#onInitSymbol(bytes, now);
    const sequence = dataView(bytes).getUint32(5, true);
    if (sequence > this.#largestSequence + MAX_SEQUENCE_JUMP) return void this.counts.rejected++;
    this.counts.datagrams++;
    if (this.welcome.viewDependent) this.#recordGaps(sequence);
    if (sequence > this.#largestSequence) [this.#largestSequence, this.#largestAt] = [sequence, now];
    if (kind === END) {
      this.isAllSent = true;
      if (!this.#fruitlessEnds || now - this.#endCountedAt >= MIN_END_SPACING_MS) {
        this.#fruitlessEnds++;
        this.#endCountedAt = now;
      }
    } else if (kind === DATA) {
      // parity is only counted: browsers do not decode it
      this.#fruitlessEnds = 0;
      if (this.hasSentView) this.isAllSent = false;
      const packetIndex = dataView(bytes).getUint32(9, true);
      this.#acceptPacket(packetIndex, bytes.slice(13), true);
      if (this.#packetStates[packetIndex]) this.#highestReceived = Math.max(this.#highestReceived, packetIndex);
    }
    this.#checkFinished();
  }

  /**
   * Returns true for a symbol of an init segment before the current one. Datagrams have copies of symbols of the first
   * init segment only, so all of them are earlier ones once a second init segment is announced. A server may also copy
   * later welcome messages (those of this release do not): they may arrive before the stream delivers what precedes
   * them.
   */
  #isOfEarlierSegment(isDatagram: boolean): boolean {
    if (isDatagram) return this.#isGrown;
    if (!this.welcome || !this.#welcomeOnStream) return false;
    return hex(this.#welcomeOnStream.digest) !== hex(this.welcome.digest);
  }

  /** Builds a view update. */
  viewUpdate(camera: ViewCamera, budget: number): Uint8Array {
    this.hasSentView = true;
    return writeViewUpdate(this.welcome!.session, ++this.#numViewUpdates, camera, budget);
  }

  /** Records the missing sequence numbers before a datagram. */
  #recordGaps(sequence: number): void {
    this.#gaps.delete(sequence);
    for (let n = Math.max(this.#largestSequence + 1, sequence - MAX_GAPS); n < sequence; n++)
      this.#gaps.set(n, { requests: 0, requestedAt: -1e9 });
    for (const oldest of this.#gaps.keys()) {
      if (this.#gaps.size <= MAX_GAPS) break;
      this.#gaps.delete(oldest);
    }
  }

  /**
   * Returns the missing sequence numbers to request. Each is requested a limited number of times, because requests may
   * be lost.
   */
  #sequencesToRequest(now: number): number[] {
    const last = this.isAllSent ? this.#largestSequence : this.#largestSequence - REORDER_THRESHOLD,
      nacks: number[] = [];
    for (const [sequence, gap] of this.#gaps) {
      if (sequence > last || nacks.length === MAX_NACKS) break;
      if (now - gap.requestedAt < NACK_INTERVAL_MS) continue;
      if (gap.requests === MAX_NACK_ATTEMPTS) {
        this.#gaps.delete(sequence);
        continue;
      }
      gap.requests++;
      gap.requestedAt = now;
      nacks.push(sequence);
    }
    return nacks;
  }

  /** Returns the indices of overdue packets. */
  #packetsToRequest(now: number): number[] {
    const { packets, bundled } = this.welcome!,
      nacks: number[] = [];
    const stop = this.isAllSent ? packets : this.#highestReceived + 1 - REORDER_THRESHOLD;
    while (this.#lowestMissing < packets && this.#packetStates[this.#lowestMissing]) this.#lowestMissing++;
    for (
      let packetIndex = this.head ? this.#lowestMissing : Math.max(bundled, this.#lowestMissing);
      packetIndex < stop && nacks.length < MAX_NACKS;
      packetIndex++
    ) {
      if (this.#packetStates[packetIndex] || now - (this.#packetNackedAt.get(packetIndex) ?? -1e9) < NACK_INTERVAL_MS)
        continue;
      const attempts = this.#nackCounts.get(packetIndex) ?? 0;
      if (this.#beganLive && attempts === MAX_NACK_ATTEMPTS) {
        this.#packetStates[packetIndex] = 2; // any late packet of a live stream, keyframe Gaussians included
        this.#nackCounts.delete(packetIndex);
        this.#packetNackedAt.delete(packetIndex);
        continue;
      }
      this.#nackCounts.set(packetIndex, attempts + 1);
      this.#packetNackedAt.set(packetIndex, now);
      nacks.push(packetIndex);
    }
    return nacks;
  }

  feedback(now: number): Uint8Array {
    return writeFeedback({
      session: this.welcome!.session,
      largest: Math.max(this.#largestSequence, 0),
      received: Math.min(this.counts.datagrams, this.#largestSequence + 1),
      clock: Math.round(this.#largestAt * 1000),
      symbolsMissing: this.head ? 0 : (this.#initSegment?.missing ?? 0),
      nacks: this.hasSentView ? [] : this.#packetsToRequest(now),
      lostSequences: this.hasSentView ? this.#sequencesToRequest(now) : [],
    });
  }

  bye(): Uint8Array {
    return writeBye(this.welcome!.session);
  }

  #onWelcome(bytes: Uint8Array, now: number): void {
    const welcome = readWelcome(bytes, this.nonce);
    if (!welcome) return void (this.finished = IMPOSSIBLE);
    this.welcome = welcome;
    this.#beganLive = welcome.isLive;
    this.#initSegment = new InitSegment(welcome);
    this.#packetStates = new Uint8Array(welcome.packets);
    if (this.before) this.#resume(this.before, welcome);
    this.#processEarly(now);
  }

  /**
   * Continues with stored packets. Only those with the same order have known positions. If the head may have changed,
   * it is received again and compared.
   */
  #resume(before: StoredStream, welcome: Welcome): void {
    if (welcome.streamId !== before.head.manifest.streamId || welcome.isLive) return void (this.isSameStream = false);
    const bits = before.bitsOf(welcome.orderDigest);
    if (!bits && (welcome.bundled || sha256(before.initSegment) !== hex(welcome.digest))) return;
    this.isSameStream = true;
    this.head = before.head;
    for (let packetIndex = 0; bits && packetIndex < Math.min(welcome.packets, 8 * bits.length); packetIndex++)
      this.#packetStates[packetIndex] = (bits[packetIndex >> 3] >> (packetIndex & 7)) & 1;
    this.counts.packets = this.#packetStates.reduce((sum, one) => sum + one, 0);
    this.#haveMessages = writeHave(this.nonce, welcome.streamId, bits ?? new Uint8Array());
    this.#checkFinished();
  }

  /** Processes a later welcome message: a longer stream, the next period, or a duplicate. */
  #onLaterWelcome(bytes: Uint8Array, now: number): void {
    const before = this.welcome!,
      next = readWelcome(bytes, this.nonce);
    if (!next || !before.isLive || next.session !== before.session) return;
    const isSame = next.streamId === before.streamId;
    if (isSame ? next.packets < before.packets : next.streamId === this.#previousPeriodId) return;
    if (isSame && next.isLive === before.isLive && hex(next.digest) === hex(before.digest)) return;
    this.welcome = next;
    this.#isGrown = true;
    this.#numWelcomesSinceHead++;
    this.#initSegment = new InitSegment(next);
    this.head = null;
    this.isAllSent = false;
    this.#fruitlessEnds = 0;
    const states = new Uint8Array(next.packets);
    if (isSame) states.set(this.#packetStates);
    else this.#resetPeriod(before.streamId);
    this.#packetStates = states;
    this.#processEarly(now);
  }

  /** Discards the state of the previous period. */
  #resetPeriod(streamId: number): void {
    this.#previousPeriodId = streamId;
    this.#packetNackedAt.clear();
    this.#nackCounts.clear();
    this.#highestReceived = -1;
    this.#lowestMissing = this.counts.packets = 0;
    this.newPackets = [];
    this.#indexOfIdentity.clear();
    this.#identityOfIndex.clear();
  }

  /** Processes the datagrams and packets that waited for this welcome message. */
  #processEarly(now: number): void {
    for (const early of this.#earlyDatagrams.splice(0)) {
      this.counts.bytes -= early.length; // it was counted on arrival
      this.receive(early, now);
    }
    for (const { index, bytes } of this.#waitingPackets.splice(0)) this.#acceptPacket(index, bytes);
  }

  #onInitSymbol(bytes: Uint8Array, now: number): void {
    if (this.head) return; // the head is complete
    if (!this.#initSegment!.add(bytes)) return void this.counts.rejected++;
    if (this.#initSegment!.missing) return;
    this.initSegmentMs ??= now - this.began;
    try {
      const { head, bundled } = this.#initSegment!.read();
      this.head = head;
      this.numInitSegments++;
      this.#numWelcomesSinceHead = 0;
      if (this.before) this.isSameStream ??= this.#initSegment!.hasManifestOf(this.before.initSegment);
      bundled.forEach((packet, packetIndex) => this.#acceptPacket(packetIndex, packet));
      this.#checkFinished();
    } catch (error) {
      this.finished = (error as Error).message;
    }
  }

  /** Accepts a packet. In a growing stream it may arrive before the message that announces it (`mayWait`). */
  #acceptPacket(packetIndex: number, bytes: Uint8Array, mayWait = false): void {
    if (!this.head && this.newPackets.length >= MAX_PACKETS_BEFORE_HEAD) return void this.counts.rejected++;
    const { packets, maxPacketBytes, streamId, isLive, orderDigest } = this.welcome!,
      packet = readPacket(bytes, streamId);
    if (packetIndex >= packets || bytes.length > maxPacketBytes || !packet) {
      if (isLive && mayWait && this.#waitingPackets.length < MAX_WAITING_PACKETS)
        this.#waitingPackets.push({ index: packetIndex, bytes });
      else this.counts.rejected++;
      return;
    }
    if (!isLive && this.#contradicts(packetIndex, identityOf(packet))) {
      this.newPackets.push({ order: UNKNOWN_ORDER, position: packetIndex, bytes });
      this.counts.rejected++;
      return;
    }
    if (this.#packetStates[packetIndex] === 1) return void this.counts.duplicates++;
    this.#packetStates[packetIndex] = 1;
    this.newPackets.push({ order: orderDigest, position: packetIndex, bytes });
    this.counts.packets++;
    this.counts.receivedPacketBytes += bytes.length;
  }

  /**
   * Returns true if the packet arrived at another position before, or another packet at this one, since the position in
   * a datagram has no checksum. Both positions then count as missing.
   */
  #contradicts(packetIndex: number, identity: number): boolean {
    const knownIndex = this.#indexOfIdentity.get(identity) ?? packetIndex,
      knownIdentity = this.#identityOfIndex.get(packetIndex) ?? identity;
    if (knownIndex === packetIndex && knownIdentity === identity) {
      this.#indexOfIdentity.set(identity, packetIndex);
      this.#identityOfIndex.set(packetIndex, identity);
      return false;
    }
    for (const index of [packetIndex, knownIndex]) {
      const oldIdentity = this.#identityOfIndex.get(index);
      if (oldIdentity !== undefined) this.#indexOfIdentity.delete(oldIdentity);
      this.#identityOfIndex.delete(index);
      if (this.#packetStates[index]) this.counts.packets--;
      this.#packetStates[index] = 0;
      this.#lowestMissing = Math.min(this.#lowestMissing, index);
    }
    if (++this.#contradictions > MAX_CONTRADICTIONS) this.finished = "the server's packets contradict each other";
    return true;
  }

  #checkFinished(): void {
    if (!this.head || this.welcome!.isLive) return;
    if (this.counts.packets === this.welcome!.packets) this.finished = "complete";
    else if (!this.hasSentView && this.#fruitlessEnds >= MAX_FRUITLESS_ENDS) this.finished = "sent";
  }
}
