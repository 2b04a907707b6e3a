// What a worker has received of one stream: it decodes, conceals, and hands over what is to be drawn.

import { readPreview } from "./codec/preview.ts";
import type { Camera } from "./model/camera.ts";
import { Moving } from "./moving.ts";
import { ContainerReader, type Head } from "./packets/container.ts";
import { buffersOf, pack } from "./render/packed.ts";
import type { Receiver } from "./transport/attempts.ts";
import type { Arrived, Counts, Fetching } from "./transport/events.ts";
import { Held } from "./transport/held.ts";
import { Kept } from "./transport/kept.ts";
import type { FromWorker, ToWorker } from "./transport/messages.ts";
import { isIntact } from "./transport/packet_reader.ts";
import { Received } from "./transport/received.ts";
import { nextTurn, pausing, SLICE_MS } from "./turns.ts";

const SHOW_MS = 30,
  COUNT_MS = 200;

const KEPT = "kept by this browser",
  SEEN = "Everything that this view needs is there.";
/** For what looks the same to all cameras. */
const ANYWHERE: Camera = { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };

export const say = (message: FromWorker, hand: ArrayBuffer[] = []): void =>
  self.postMessage(message, { transfer: hand });

const buffersOfGains = (...arrays: (Float32Array | null)[]): ArrayBuffer[] =>
  arrays.flatMap((gains) => (gains ? [gains.buffer as ArrayBuffer] : []));

export class Reception implements Receiver {
  /** What of the file is there. */
  readonly held = new Held();
  /** Where what arrives is kept for the next time; null where it is not. */
  kept: Kept | null = null;
  /** Why nothing more is decoded; null as long as there is no reason. */
  failed: Error | null = null;
  #received: Received | null = null;
  readonly #moving = new Moving(say);
  #size = 1;
  #shownAt = 0;
  #ask = 0;
  /** Where the page looks from, its number, and whether it was answered. */
  #camera = ANYWHERE;
  #look = 0;
  #looked = 0;
  #drawing: Promise<void> | null = null;
  /** Pieces of a scene with levels that the page draws, and of how many packets. */
  readonly #pieces = new Map<number, number>();
  #decodeMs = 0;
  #counts: Counts | null = null;
  /** What was there from the beginning, all of it. */
  #before: Received | null = null;
  #bytesBefore = 0;
  readonly #began = performance.now();
  #countedAt = 0;
  #moved: (() => void)[] = [];
  /** Packets that are not decoded yet, and the work that decodes them until there are none. */
  readonly #waiting: { readonly bytes: Uint8Array; readonly of: Received }[] = [];
  #working: Promise<void> | null = null;
  /** True while all packets are from an earlier visit, and the file may have been replaced since. */
  #unconfirmed = false;

  /** One that is no preview is nothing to fail for. */
  preview(bytes: Uint8Array): void {
    try {
      const { splats, background } = readPreview(bytes),
        packed = pack([splats], 0, 1);
      say({ kind: "preview", packed, background }, buffersOf(packed));
    } catch (error) {
      say({ kind: "note", text: (error as Error).message });
    }
  }

  /** A second way brings the head once more: what is there stays. Of a live clip it is a longer one, or another. */
  head(head: Head, file: Uint8Array, keep: boolean, live = false): void {
    const { streamId } = head.manifest,
      known = this.#received?.decoder.head.manifest.streamId === streamId,
      received = known ? this.#received : new Received(head);
    if (!keep) this.kept = null;
    if (live && received?.decoder.schema.moving) return this.#lives(head, received, known);
    if (!known || !this.held.begun) {
      this.held.begin(file, head);
      this.kept?.begin(file);
    }
    if (!received || known) return;
    this.#received = received;
    this.#pieces.clear();
    this.#waiting.length = 0; // of another stream
    this.#look = this.#looked = 0;
    this.#unconfirmed = false;
    this.#tellFacts(received);
  }

  /** Shows the kept packets: they are of the stream as it is now. */
  confirmed(): void {
    if (!this.#unconfirmed) return;
    this.#unconfirmed = false;
    this.#tellFacts(this.#received!);
    void this.#draw();
  }

  /** Forgets everything: it is of a file that was replaced. */
  changed(): void {
    this.held.clear();
    void this.kept?.clear();
    this.#received = this.#before = null;
    this.#waiting.length = 0;
    this.#pieces.clear();
    this.#look = this.#looked = 0;
    this.#unconfirmed = false;
    this.failed = null; // it was of the file that is gone
  }

  /** A live clip begins, goes on with more groups, or with its next chapter. */
  #lives(head: Head, received: Received, known: boolean): void {
    const begins = !this.live;
    this.#received = received;
    this.#moving.follow(head, received, known);
    if (begins) this.#tellFacts(received);
    this.#moving.tellPlayable();
  }

  /** Whether it is a live clip: there is no file of it, and nobody can have all of it. */
  get live(): boolean {
    return this.#moving.live;
  }

  #tellFacts({ decoder }: Received): void {
    const { head } = decoder,
      { manifest } = head,
      section = decoder.schema.sections.get("preview");
    if (section) this.preview(section);
    const facts = {
      gaussians: decoder.schema.tiling?.enough ?? manifest.count,
      packets: manifest.numPackets,
      degree: decoder.schema.degree,
      viewDependent: decoder.schema.viewDependent,
      size: decoder.schema.size,
      middle: decoder.schema.middle,
      background: decoder.background,
      viewpoint: decoder.viewpoint,
      extent: decoder.extent,
      antialiased: decoder.antialiased,
      up: decoder.up,
      sideInfoBytes: manifest.sideInfoBytes,
      concealers: decoder.schema.moving?.concealers ?? Object.keys(decoder.schema.concealers),
      moving: decoder.schema.moving && { ...decoder.schema.moving.times, live: this.live },
    };
    this.#size = facts.size;
    say({ kind: "facts", facts });
  }

  packets(packets: readonly Arrived[]): void {
    const fresh = this.live ? packets : this.held.add(packets);
    this.kept?.add(fresh);
    this.#take(fresh);
  }

  #take(packets: readonly Arrived[]): void {
    for (const { bytes } of packets) this.#waiting.push({ bytes, of: this.#received! });
    this.#working ??= this.#decode();
  }

  /** Begins with the packets that an earlier visit kept of this file. They are shown once the file is compared. */
  async resume(file: string): Promise<void> {
    this.kept = await Kept.open(file);
    const before = (await this.kept?.read()) ?? null;
    if (!before) return;
    try {
      const container = new ContainerReader();
      container.feed(before.head);
      if (!container.head) throw new Error("a part of a head was kept");
      this.#resume(container.head, before.head, before.packets);
    } catch {
      this.changed(); // damaged there, or kept by another version
    }
  }

  #resume(head: Head, file: Uint8Array, kept: readonly Arrived[]): void {
    const expected = head.manifest.numPackets,
      intact = kept.filter(({ place, bytes }) => place < expected && isIntact(bytes, head));
    this.#received = new Received(head);
    this.#unconfirmed = true;
    this.held.begin(file, head);
    this.#take(this.held.add(intact));
    const { count } = this.held;
    this.#counts = { way: KEPT, bytes: 0, packets: count, expected, lost: 0, rejected: 0, seconds: 0 };
    if (count === expected) this.#before = this.#received;
    if (intact.length === kept.length) return;
    this.kept?.begin(file); // without what is damaged
    this.kept?.add(this.held.packets);
  }

  counts(counts: Counts): void {
    if (this.#counts && counts.bytes < this.#counts.bytes) this.#bytesBefore += this.#counts.bytes; // another way
    this.#counts = counts;
    if (performance.now() - this.#countedAt > COUNT_MS) this.#tell(counts);
  }

  #tell(counts: Counts): void {
    if (this.#unconfirmed) return;
    this.#countedAt = performance.now();
    const intake = this.#received?.decoder.intake,
      packets = Math.max(counts.packets, intake?.size ?? 0),
      bytes = this.#bytesBefore + counts.bytes,
      seconds = (performance.now() - this.#began) / 1000,
      expected = this.#received?.decoder.head.manifest.numPackets ?? counts.expected,
      way = this.#before && this.#before === this.#received ? KEPT : counts.way;
    say({
      kind: "counts",
      counts: { ...counts, packets, bytes, seconds, expected, way },
      decodeMs: this.#decodeMs,
      corrupt: intake?.counts.corrupt ?? 0,
    });
  }

  /** Resolves when everything that came is decoded and handed over. */
  async settled(): Promise<void> {
    while (this.#working) await this.#working;
    await this.#draw();
    await this.kept?.flush();
    if (this.#counts) this.#tell(this.#counts);
  }

  /** Decodes what waits, a little at a time: the session must be served meanwhile. What takes too much ends it. */
  async #decode(): Promise<void> {
    await nextTurn(); // so that this work is known before it can end
    while (this.#waiting.length && !this.failed) {
      const began = performance.now();
      try {
        while (this.#waiting.length && performance.now() - began < SLICE_MS) {
          const { bytes, of } = this.#waiting.shift()!;
          of.take(bytes);
        }
      } catch (error) {
        this.failed = error as Error;
      }
      this.#decodeMs += performance.now() - began;
      this.#moving.tellPlayable();
      if (performance.now() - this.#shownAt > SHOW_MS) void this.#draw();
      await nextTurn();
    }
    this.#waiting.length = 0;
    this.#working = null;
  }

  note(text: string): void {
    say({ kind: "note", text });
  }

  /** Also shows kept packets, which are better than nothing while the server cannot be reached. */
  lost(reason: string, retryMs: number): void {
    this.confirmed();
    void this.settled().then(() => say({ kind: "lost", reason, retryMs }));
  }

  stopped(): boolean {
    return this.failed !== null;
  }

  look({ camera, ask }: ToWorker & { kind: "look" }): void {
    this.#camera = camera;
    this.#look = ask;
    if (this.#looked === ask) this.#looked = 0; // the count begins again with another stream
    void this.#draw().then(() => {
      for (const resolve of this.#moved.splice(0)) resolve();
    });
  }

  /** Hands over what was decoded since the last time, or everything anew where the page looks from somewhere else. */
  #draw(): Promise<void> {
    return (this.#drawing ??= this.#drawAll().finally(() => (this.#drawing = null)));
  }

  async #drawAll(): Promise<void> {
    this.#shownAt = performance.now();
    for (let drawn: Received | null = null; drawn !== this.#received; ) {
      drawn = this.#received;
      if (drawn) await this.#drawOne(drawn); // another stream may take its place meanwhile
    }
  }

  async #drawOne(received: Received): Promise<void> {
    const { schema } = received.decoder;
    if (this.#unconfirmed || schema.moving || (schema.viewDependent && !this.#look)) return;
    if (schema.tiling) return this.#drawTiles(received);
    while (received.hasNew || this.#looked !== this.#look) {
      const ask = this.#look,
        shown = await received.seen(this.#camera, this.#looked !== ask, pausing());
      if (!shown || received !== this.#received) return;
      this.#looked = ask;
      const { parts, instead, fresh, elements, copies } = shown,
        gains = instead ? received.gains : null,
        lossless = instead ? received.gainsWithoutCopies : null,
        { degree, size } = schema;
      const packed = pack(parts, degree, size),
        hand = [...buffersOf(packed), ...buffersOfGains(gains, lossless)];
      say({ kind: "splats", packed, instead, fresh, elements, copies, gains, lossless, ask }, hand);
    }
  }

  /** Hands over what takes the place of pieces that the page draws; looks again after each swap if there is reason. */
  async #drawTiles(received: Received): Promise<void> {
    const { degree, size, tiling } = received.decoder.schema,
      pause = pausing();
    while (received.hasNew || this.#looked !== this.#look) {
      const ask = this.#look;
      let fresh = received.hasNew;
      for (const { gone, come } of received.swaps(this.#camera, this.#pieces)) {
        const tiles = [];
        for (const tile of gone) this.#pieces.delete(tile);
        for (const tile of come) {
          await pause();
          if (received !== this.#received) return;
          const parts = tiling!.splatsOf(tile);
          tiles.push({ tile, packed: pack(parts, degree, size) });
          this.#pieces.set(tile, parts.length);
        }
        const hand = tiles.flatMap(({ packed }) => buffersOf(packed));
        say({ kind: "tiles", gone, come: tiles, fresh, ask }, hand);
        fresh = false;
        if (ask !== this.#look) break; // somebody looks from elsewhere by now
      }
      if (ask === this.#look) this.#looked = ask;
      say({ kind: "tiles", gone: [], come: [], fresh, ask });
    }
  }

  /** Hands over a frame of what moves. */
  frame(message: ToWorker & { kind: "frame" }): void {
    this.#moving.frame(message, this.#received, this.#size);
  }

  async conceal({ choice, ask }: ToWorker & { kind: "conceal" }): Promise<void> {
    const received = this.#received;
    if (!received) return;
    const pause = pausing(() => this.#ask === ask);
    this.#ask = ask;
    try {
      await received.prepare(choice, pause);
    } catch (error) {
      say({
        kind: "note",
        text: `Nothing is concealed: ${(error as Error).message}.`,
      });
      choice = { ...choice, concealer: "drop" };
    }
    await this.#draw();
    const shownPackets = await received.conceal(choice, pause),
      pieces = [...this.#pieces.keys()].sort((a, b) => a - b),
      gains = received.decoder.schema.tiling ? received.gainsOfPieces(pieces) : received.gains;
    if (shownPackets === null || !gains) return;
    const lossless = received.gainsWithoutCopies;
    say({ kind: "gains", gains, lossless, shownPackets, ask }, buffersOfGains(gains, lossless));
  }

  /** Whether every packet is there and decoded. */
  get complete(): boolean {
    return this.#received?.decoder.intake.complete ?? false;
  }

  /** Tells whether all integers are those that were encoded: decodes all of them once more. */
  async digest(): Promise<void> {
    const decoder = this.#received?.decoder,
      expected = decoder?.head.manifest.symbolsDigest ?? "",
      same = decoder !== undefined && (await decoder.digest(pausing())) === expected;
    // Held packets that are no complete stream are of several orders or files: the next visit begins without them.
    if (!same && (this.complete || this.held.complete)) await this.kept?.clear();
    say({ kind: "digest", same });
  }

  get looking(): Camera | null {
    return this.#look && this.#received?.decoder.schema.tiling ? this.#camera : null;
  }

  sawAll(): void {
    void this.settled().then(() => {
      if (!this.#received?.decoder.schema.tiling?.wanted.length) this.note(SEEN);
    });
  }

  get fetching(): Fetching | null {
    const received = this.#received,
      tiling = received?.decoder.schema.tiling;
    if (!received || !tiling) return null;
    const { intake } = received.decoder,
      wanted = (): readonly number[] => (this.#look ? tiling.wanted : []); // before, nobody knows
    return {
      head: received.decoder.head,
      tiles: tiling.tiles,
      get wanted() {
        return wanted();
      },
      get packets() {
        return intake.size;
      },
      missing: (tile) => tiling.tiles.packets[tile] - (intake.blocks.get(tile)?.length ?? 0),
      moved: async (isGivenUp) => {
        await this.#draw();
        if (wanted().some((tile) => !isGivenUp(tile))) return; // it looks from elsewhere by now
        if (this.#counts) this.#tell(this.#counts);
        if (this.#look) this.note(SEEN);
        await new Promise<void>((resolve) => this.#moved.push(resolve));
      },
      taken: async () => {
        while (this.#working) await this.#working;
        await this.#draw();
      },
    };
  }

  get begun(): boolean {
    return this.#received !== null;
  }
}
