// State of a stream in the worker: received packets, decoder, concealer, and the messages with Gaussians for the page.

import { BitstreamError } from "./bytes.ts";
import type { GaussianDecoder } from "./codec/gaussians/gaussian_decoder.ts";
import type { Splats } from "./codec/splats.ts";
import { headerOf, readUpdate, type SceneUpdate } from "./codec/update/update.ts";
import { UpdatedScene } from "./codec/update/updated_scene.ts";
import { ANY_CAMERA, type Camera } from "./model/camera.ts";
import { type DecodedBatch, type HelperThread, numHelpers, PacketPool } from "./packet_pool.ts";
import { ContainerReader, type Head } from "./packets/container.ts";
import type { Packet } from "./packets/packet.ts";
import { bufferOf, keepPacked, pack } from "./render/packed.ts";
import { packPreview } from "./render/packed_preview.ts";
import { delay, nextTask, type Pause, periodicPause, SLICE_MS } from "./scheduler.ts";
import { SequenceFrames } from "./sequence_frames.ts";
import { DecodedStream } from "./transport/decoded_stream.ts";
import type { Counts, ReceivedPacket, TileRequest } from "./transport/events.ts";
import type { Receiver } from "./transport/failover.ts";
import { uncachedUrl } from "./transport/http_file.ts";
import type { LossSimulation } from "./transport/losses.ts";
import type { FromWorker, ToWorker } from "./transport/messages.ts";
import { PacketCache } from "./transport/packet_cache.ts";
import { isIntact, PacketStore, packetOf } from "./transport/packet_store.ts";
import { fileManifest, manifestDigest, readWhole, updateUrl } from "./transport/updates.ts";

/** Minimum interval between messages with Gaussians for the page, milliseconds. */
const SEND_INTERVAL_MS = 30;
/** Minimum interval between messages with counts, milliseconds. */
const COUNT_INTERVAL_MS = 200;

const FROM_CACHE = "kept by this browser",
  VIEW_COMPLETE = "All that this view needs is there.";
/**
 * Groups of frames of a live clip are dropped while this number of packets waits for decoding: about a minute at
 * 10 Mbit/s.
 */
const MAX_WAITING = 65_536;
/** Memory for integers that are compared with the digest later, bytes. */
const VERIFICATION = { keptBytes: 32 << 20 };

/**
 * Interval of requests for the next update, and its largest value after failures, milliseconds.
 */
const UPDATE_MS = 1000,
  MAX_UPDATE_MS = 30_000;
/** Number of requests without an answer, and of damaged answers, after which the file of the scene is requested. */
const RELOAD_POLLS = 15,
  MAX_DAMAGED = 3;
/**
 * Largest ratio of the sizes of a scene before and after its file was replaced. All states are drawn in units of the
 * first one, and half floats have few digits for Gaussians that are much smaller.
 */
const MAX_SIZE_RATIO = 16;

const sceneOf = ({ decoder, splats }: DecodedStream, manifest: Uint8Array): UpdatedScene => {
  const { info } = decoder.elementDecoder as GaussianDecoder;
  return new UpdatedScene(manifestDigest(manifest), info, headerOf(decoder.head.sideInfo), splats);
};

/** Starts another thread with the script of this one. Throws if this thread cannot start threads. */
const startHelper = (): HelperThread => new Worker(self.location.href);

export const post = (message: FromWorker, transfer: ArrayBuffer[] = []): void =>
  self.postMessage(message, { transfer });

const buffersOfGains = (...arrays: (Float32Array | null)[]): ArrayBuffer[] =>
  arrays.flatMap((gains) => (gains ? [gains.buffer as ArrayBuffer] : []));

/** Packets that a helper decodes. */
interface Batch {
  readonly stream: DecodedStream;
  readonly packets: readonly Packet[];
  readonly decoded: Promise<DecodedBatch | null>;
}

export class WorkerReceiver implements Receiver {
  /** Received packets of the stream; stays empty for live clips. */
  readonly store = new PacketStore();
  /** Browser cache for the next visit; null if unavailable. */
  cache: PacketCache | null = null;
  /** Error that ended decoding; null without one. */
  failed: Error | null = null;
  /** Number of received packets of this visit. It never decreases. */
  numReceived = 0;
  #stream: DecodedStream | null = null;
  readonly #sequenceFrames = new SequenceFrames(post);
  #size = 1;
  #sentAt = 0;
  #concealRequest = 0;
  /** Maximum number of Gaussians that the view of a scene with levels may draw. */
  #budget = 0;
  /** Camera of the page, its request number, and the number of the last answered request. */
  #camera = ANY_CAMERA;
  #viewRequest = 0;
  #answeredRequest = 0;
  #sending: Promise<void> | null = null;
  /** Drawn units (`codec/levels/draw_units.ts`) of a scene with levels, and the number of packets of each one. */
  readonly #drawnUnits = new Map<number, number>();
  /** Stream whose default viewpoint the page can compute. */
  #framed: DecodedStream | null = null;
  #decodeMs = 0;
  #counts: Counts | null = null;
  /** State restored completely from the cache; null otherwise. */
  #cachedStream: DecodedStream | null = null;
  #bytesBefore = 0;
  readonly #began = performance.now();
  #countedAt = 0;
  #viewWaiters: (() => void)[] = [];
  /** Packets that are not decoded yet, and the running decoding loop. */
  readonly #waitingPackets: { readonly bytes: Uint8Array; readonly stream: DecodedStream }[] = [];
  #decoding: Promise<void> | null = null;
  /** Groups of frames of the current period of a live clip that are dropped, because too many packets waited. */
  readonly #droppedGroups = new Set<number>();
  /** Helper threads; `#batches` are the batches in decoding, in order of arrival. */
  #pool: PacketPool | null = null;
  readonly #batches: Batch[] = [];
  /** Complete scene for the application of updates; null until updates are requested. */
  #updated: UpdatedScene | null = null;
  /** True while updates are wanted. */
  #followsUpdates = false;
  /** Stream of the scene before all updates in `#updated`. */
  #updatedFrom: DecodedStream | null = null;
  /** True once everything was compared with the digest. */
  #isVerified = false;
  /** True while all packets are from the cache and the file may have been replaced since. */
  #unconfirmed = false;

  /** Shows a preview. An invalid one is reported but is no failure. */
  preview(bytes: Uint8Array): void {
    try {
      const preview = packPreview(bytes);
      post({ kind: "preview", ...preview }, [bufferOf(preview.packed)]);
    } catch (error) {
      post({ kind: "note", text: (error as Error).message });
    }
  }

  /** Processes a head. A second source may repeat it; live clips send longer ones and those of new periods. */
  head(head: Head, fileHead: Uint8Array, keep: boolean, live = false): void {
    const isSameStream = this.#isSameStream(head, fileHead, live),
      stream = isSameStream ? this.#stream : new DecodedStream(head, live ? null : VERIFICATION);
    if (!keep) this.cache = null;
    if (live && stream?.decoder.elementDecoder.sequence) return this.#onLiveHead(head, stream, isSameStream);
    if (!isSameStream || !this.store.hasHead) {
      this.store.begin(fileHead, head);
      this.cache?.begin(fileHead);
    }
    if (!stream || isSameStream) return;
    this.#stream = stream;
    this.#sequenceFrames.clear();
    this.#drawnUnits.clear();
    this.#waitingPackets.length = 0; // left over from another stream
    this.#viewRequest = this.#answeredRequest = 0;
    this.#unconfirmed = false;
    this.#startPool(stream, fileHead);
    this.#reportStreamInfo(stream);
  }

  /** Starts helpers for a stream that several threads can decode. */
  #startPool({ decoder }: DecodedStream, fileHead: Uint8Array): void {
    this.#closePool();
    this.#isVerified = false;
    const { navigator: device = {} } = globalThis as Partial<typeof globalThis>, // node 20 has none
      count = decoder.elementDecoder.decode ? numHelpers(decoder.head.manifest.count, device) : 0;
    if (count) this.#pool = new PacketPool(fileHead, startHelper, count);
  }

  #closePool(): void {
    this.#pool?.close();
    this.#pool = null;
  }

  /** Returns true if the head is that of the current stream. A growing stream keeps only its id. */
  #isSameStream({ manifest }: Head, fileHead: Uint8Array, live: boolean): boolean {
    const before = this.#stream?.decoder.head.manifest;
    if (live !== this.live) return false;
    return before?.streamId === manifest.streamId && (live || !this.store.hasHead || this.store.isSame(fileHead));
  }

  /** Shows the cached packets after successful revalidation. */
  confirmed(): void {
    if (!this.#unconfirmed) return;
    this.#unconfirmed = false;
    this.#reportStreamInfo(this.#stream!);
    void this.#send();
  }

  /** Discards all packets, because their file was replaced. */
  changed(): void {
    this.store.clear();
    void this.cache?.clear();
    this.#stream = this.#cachedStream = null;
    this.#waitingPackets.length = 0;
    this.#closePool();
    this.#drawnUnits.clear();
    this.#viewRequest = this.#answeredRequest = 0;
    this.#unconfirmed = false;
    this.failed = null; // it belonged to the replaced file
  }

  /** Processes a head of a live clip: its first one, one with more groups, or that of the next period. */
  #onLiveHead(head: Head, stream: DecodedStream, isSameStream: boolean): void {
    if (!isSameStream) this.#droppedGroups.clear();
    this.#stream = stream;
    if (this.#sequenceFrames.onLiveHead(head, stream, isSameStream)) this.#reportStreamInfo(stream);
    this.#sequenceFrames.reportPlayable();
  }

  /** True for live clips. They have no last packet. */
  get live(): boolean {
    return this.#sequenceFrames.live;
  }

  #reportStreamInfo({ decoder }: DecodedStream): void {
    const { head } = decoder,
      { manifest } = head,
      section = decoder.elementDecoder.sections.get("preview");
    if (section) this.preview(section);
    const info = {
      numElements: decoder.elementDecoder.tiling?.baseCount ?? manifest.count,
      packets: manifest.numPackets,
      degree: decoder.elementDecoder.degree,
      viewDependent: decoder.elementDecoder.viewDependent,
      size: decoder.elementDecoder.size,
      middle: decoder.elementDecoder.middle,
      background: decoder.background,
      viewpoint: decoder.viewpoint,
      extent: decoder.extent,
      antialiased: decoder.antialiased,
      up: decoder.up,
      texts: decoder.texts,
      origin: decoder.origin,
      sideInfoBytes: manifest.sideInfoBytes,
      concealers: decoder.elementDecoder.sequence?.concealers ?? Object.keys(decoder.elementDecoder.concealers),
      sequence: decoder.elementDecoder.sequence && { ...decoder.elementDecoder.sequence.timeline, live: this.live },
    };
    this.#size = info.size;
    post({ kind: "info", info });
  }

  packets(packets: readonly ReceivedPacket[]): void {
    const added = this.live ? packets : this.store.add(packets);
    this.numReceived += added.length;
    this.cache?.add(added);
    this.#enqueue(added);
  }

  #enqueue(packets: readonly ReceivedPacket[]): void {
    const stream = this.#stream!;
    for (const { bytes } of packets) if (!this.#isDropped(bytes, stream)) this.#waitingPackets.push({ bytes, stream });
    this.#decoding ??= this.#decode();
  }

  /**
   * Returns true if a packet of a live clip is dropped, because too many wait. All later packets of its group are
   * dropped, too, so that few groups have losses.
   */
  #isDropped(bytes: Uint8Array, { decoder }: DecodedStream): boolean {
    const isFull = this.#waitingPackets.length >= MAX_WAITING,
      groups = this.#droppedGroups;
    if (!this.live || !(isFull || groups.size)) return false;
    const packet = packetOf(bytes, decoder.head);
    if (!packet) return true;
    const group = decoder.intake.plan.gopOf(packet.block);
    if (isFull) groups.add(group);
    return groups.has(group);
  }

  /** Restores the cached packets of an earlier visit. They are shown once the file is revalidated. */
  async resume(file: string): Promise<void> {
    this.cache = await PacketCache.open(file);
    const before = (await this.cache?.read()) ?? null;
    if (!before) return;
    try {
      const container = new ContainerReader();
      container.feed(before.head);
      if (!container.head) throw new Error("a part of a head was kept");
      this.#resume(container.head, before.head, before.packets);
    } catch {
      this.changed(); // the cache entry is damaged or of another version
    }
  }

  #resume(head: Head, fileHead: Uint8Array, cached: readonly ReceivedPacket[]): void {
    const expected = head.manifest.numPackets,
      intact = cached.filter(({ bytes }) => isIntact(bytes, head));
    this.#stream = new DecodedStream(head, VERIFICATION);
    this.#unconfirmed = true;
    this.#startPool(this.#stream, fileHead);
    this.store.begin(fileHead, head);
    this.#enqueue(this.store.add(intact));
    const { count } = this.store;
    this.#counts = { transport: FROM_CACHE, bytes: 0, packets: count, expected, lost: 0, rejected: 0, seconds: 0 };
    if (count === expected) this.#cachedStream = this.#stream;
    if (intact.length === cached.length) return;
    this.cache?.begin(fileHead); // removes damaged records from the cache
    this.cache?.add(this.store.packets);
  }

  counts(counts: Counts): void {
    // another source counts from 0
    if (this.#counts && counts.bytes < this.#counts.bytes) this.#bytesBefore += this.#counts.bytes;
    this.#counts = counts;
    if (performance.now() - this.#countedAt > COUNT_INTERVAL_MS) this.#reportCounts(counts);
  }

  #reportCounts(counts: Counts): void {
    if (this.#unconfirmed) return;
    this.#countedAt = performance.now();
    const intake = this.#stream?.decoder.intake,
      arrived = this.live ? counts.packets : this.store.count,
      packets = Math.max(arrived, intake?.size ?? 0),
      bytes = this.#bytesBefore + counts.bytes,
      seconds = (performance.now() - this.#began) / 1000,
      expected = this.#stream?.decoder.head.manifest.numPackets ?? counts.expected,
      transport = this.#cachedStream && this.#cachedStream === this.#stream ? FROM_CACHE : counts.transport;
    post({
      kind: "counts",
      counts: { ...counts, packets, bytes, seconds, expected, transport },
      decodeMs: this.#decodeMs,
      corrupt: intake?.counts.corrupt ?? 0,
      droppedGroups: this.#droppedGroups.size,
    });
  }

  /** Resolves when all received packets are decoded. */
  async #decoded(): Promise<void> {
    while (this.#decoding) await this.#decoding;
  }

  /** Resolves when all received packets are decoded and sent to the page. */
  async settled(): Promise<void> {
    await this.#decoded();
    await this.#send();
    await this.cache?.flush();
    if (this.#counts) this.#reportCounts(this.#counts);
  }

  /** Decodes waiting packets here or in helpers, in order. Stops at an error. */
  async #decode(): Promise<void> {
    await nextTask(); // `#decoding` must be set before this function can end
    while ((this.#waitingPackets.length || this.#batches.length) && !this.failed) {
      try {
        this.#fillPool();
        if (this.#batches.length) await this.#acceptBatch();
        else this.#decodeSlice();
      } catch (error) {
        this.failed = error as Error;
      }
      this.#sequenceFrames.reportPlayable();
      if (performance.now() - this.#sentAt > SEND_INTERVAL_MS) void this.#send();
      await nextTask();
    }
    this.#waitingPackets.length = this.#batches.length = 0;
    if (this.complete || this.failed) this.#closePool();
    this.#decoding = null;
  }

  /** Decodes in this thread for a short time, so that the session stays responsive. */
  #decodeSlice(): void {
    const began = performance.now();
    while (this.#waitingPackets.length && performance.now() - began < SLICE_MS) {
      const { bytes, stream } = this.#waitingPackets.shift()!;
      stream.addPacket(bytes);
    }
    this.#decodeMs += performance.now() - began;
  }

  /** Gives waiting packets of the current stream to the helpers. */
  #fillPool(): void {
    const pool = this.#pool,
      stream = this.#stream!;
    while (pool && this.#waitingPackets[0]?.stream === stream && this.#batches.length < pool.capacity) {
      const packets: Packet[] = [];
      for (
        let left = pool.batchSize(this.#waitingPackets.length);
        left && this.#waitingPackets[0]?.stream === stream;
        left--
      ) {
        const packet = stream.decoder.admit(this.#waitingPackets.shift()!.bytes);
        if (packet) packets.push(packet);
      }
      this.#batches.push({ stream, packets, decoded: pool.decode(packets) });
    }
  }

  /** Waits for the oldest batch and adds its packets. Decodes it in this thread if no helper could. */
  async #acceptBatch(): Promise<void> {
    const { stream, packets, decoded } = this.#batches.shift()!,
      batch = await decoded,
      began = performance.now();
    if (stream !== this.#stream) return; // another stream has replaced it
    for (const [n, packet] of packets.entries()) {
      const decoded = batch?.packets[n] ?? null;
      // packed again once the file is revalidated, because all of them would take as much memory as the Gaussians
      if (decoded?.packed && !this.#unconfirmed) keepPacked(decoded.splats, decoded.packed);
      stream.accept(packet, decoded);
    }
    this.#decodeMs += (batch?.ms ?? 0) + performance.now() - began;
  }

  note(text: string): void {
    post({ kind: "note", text });
  }

  /** Reports a disconnect. Cached packets are shown without revalidation while the server is unreachable. */
  disconnected(reason: string, retryMs: number): void {
    this.confirmed();
    void this.settled().then(() => post({ kind: "disconnect", reason, retryMs }));
  }

  stopped(): boolean {
    return this.failed !== null;
  }

  setView({ camera, budget, requestId }: ToWorker & { kind: "view" }): void {
    this.#camera = camera;
    this.#budget = budget;
    this.#viewRequest = requestId;
    if (this.#answeredRequest === requestId) this.#answeredRequest = 0; // numbering restarts with a new stream
    void this.#send().then(() => {
      for (const resolve of this.#viewWaiters.splice(0)) resolve();
    });
  }

  /** Sends the newly decoded Gaussians, or all Gaussians again after a change of the view. */
  #send(): Promise<void> {
    return (this.#sending ??= this.#sendAll().finally(() => (this.#sending = null)));
  }

  async #sendAll(): Promise<void> {
    this.#sentAt = performance.now();
    for (let sent: DecodedStream | null = null; sent !== this.#stream; ) {
      sent = this.#stream;
      if (sent) await this.#sendGaussians(sent); // another stream may have replaced it meanwhile
    }
  }

  async #sendGaussians(stream: DecodedStream): Promise<void> {
    const { elementDecoder } = stream.decoder;
    if (this.#unconfirmed || this.#isUpdated) return;
    this.#sendFraming(stream);
    if (elementDecoder.sequence || (elementDecoder.viewDependent && !this.#viewRequest)) return;
    if (elementDecoder.tiling) return this.#sendTiles(stream);
    while (stream.hasNew || this.#answeredRequest !== this.#viewRequest) {
      const requestId = this.#viewRequest,
        shown = await stream.gaussiansFor(this.#camera, this.#answeredRequest !== requestId, periodicPause());
      if (!shown || stream !== this.#stream) return;
      this.#answeredRequest = requestId;
      const { parts, replaceAll, hasNew, elements, copies } = shown,
        gains = replaceAll ? stream.gains : null,
        gainsWithoutCopies = replaceAll ? stream.gainsWithoutCopies : null,
        { degree, size } = elementDecoder;
      const packed = pack(parts, degree, size),
        transfer = [bufferOf(packed), ...buffersOfGains(gains, gainsWithoutCopies)];
      post(
        { kind: "splats", packed, replaceAll, hasNew, elements, copies, gains, gainsWithoutCopies, requestId },
        transfer,
      );
    }
  }

  /** Sends the Gaussians that determine the default viewpoint, once all of them have arrived. */
  #sendFraming(stream: DecodedStream): void {
    if (this.#framed === stream || this.live) return;
    const framing = stream.framingGaussians;
    if (!framing) return;
    this.#framed = stream;
    const packed = pack(framing, 0, stream.decoder.elementDecoder.size);
    post({ kind: "framing", packed }, [bufferOf(packed)]);
  }

  /** Sends tile replacements. Starts again after a swap if the view has changed. */
  async #sendTiles(stream: DecodedStream): Promise<void> {
    const { degree, size, tiling } = stream.decoder.elementDecoder,
      pause = periodicPause();
    while (stream.hasNew || this.#answeredRequest !== this.#viewRequest) {
      const requestId = this.#viewRequest;
      let hasNew = stream.hasNew;
      tiling!.budget = this.#budget;
      for (const { removed, added } of stream.swaps(this.#camera, this.#drawnUnits)) {
        const tiles = [];
        for (const tile of removed) this.#drawnUnits.delete(tile);
        for (const tile of added) {
          await pause();
          if (stream !== this.#stream) return;
          const parts = tiling!.splatsOf(tile);
          tiles.push({ tile, packed: pack(parts, degree, size) });
          this.#drawnUnits.set(tile, parts.length);
        }
        const transfer = tiles.map(({ packed }) => bufferOf(packed));
        post({ kind: "tiles", removed, added: tiles, hasNew, requestId }, transfer);
        hasNew = false;
        if (requestId !== this.#viewRequest) break; // the view has changed
      }
      if (requestId === this.#viewRequest) this.#answeredRequest = requestId;
      post({ kind: "tiles", removed: [], added: [], hasNew, requestId });
    }
  }

  /** Sends a frame of a clip. */
  frame(message: ToWorker & { kind: "frame" }): void {
    this.#sequenceFrames.frame(message, this.#stream, this.#size);
  }

  /**
   * Requests updates of the complete scene and applies them, one after another. While none exists, and after a failure,
   * the scene stays as it is. An empty `file` stops the requests.
   */
  async follow(file: string): Promise<void> {
    const stream = this.#stream;
    this.#followsUpdates = file.startsWith("http");
    if (file && !this.#followsUpdates) post({ kind: "updatemissed", reason: "only scenes on a server have updates" });
    if (
      !this.#followsUpdates ||
      this.#updated ||
      !stream?.decoder.intake.complete ||
      stream.decoder.head.manifest.codec !== "gaussians"
    )
      return;
    this.#updated = sceneOf(stream, this.store.manifestBytes);
    this.#updatedFrom = stream;
    let polls = 0,
      failures = 0;
    while (stream === this.#stream) {
      await delay(Math.min(UPDATE_MS * 2 ** failures, MAX_UPDATE_MS));
      if (!this.#followsUpdates) continue;
      try {
        const bytes = await readWhole(updateUrl(file, this.#updated.digest)),
          update = bytes && (await readUpdate(bytes, periodicPause()));
        if (!this.#followsUpdates) continue;
        if (update) {
          this.#applyUpdate(update);
          polls = 0;
        } else if (++polls % RELOAD_POLLS === 0) await this.#reload(file);
        failures = 0;
      } catch (error) {
        if (!failures && this.#followsUpdates) post({ kind: "updatemissed", reason: (error as Error).message });
        failures++;
        if (error instanceof BitstreamError && failures % MAX_DAMAGED === 0)
          await this.#reload(file).catch(() => undefined);
      }
    }
  }

  /** True if the drawn scene is no longer that of the received stream. */
  get #isUpdated(): boolean {
    return !!this.#updated && (this.#updated.changed || this.#updatedFrom !== this.#stream);
  }

  #applyUpdate(update: SceneUpdate): void {
    const scene = this.#updated!,
      drawsCopies = !this.#isUpdated && this.#stream!.hasCopies,
      { hidden, splats } = scene.apply(update),
      numNew = splats.reduce((sum, { count }) => sum + count, 0),
      replaces = scene.numHidden > scene.count || drawsCopies;
    this.#sendUpdate(replaces ? null : hidden, replaces ? scene.compact() : splats, hidden.length, numNew);
  }

  #sendUpdate(hidden: Int32Array | null, parts: readonly Splats[], numRemoved: number, numNew: number): void {
    const { elementDecoder } = this.#stream!.decoder,
      packed = pack(parts, elementDecoder.degree, elementDecoder.size);
    post({ kind: "update", hidden, packed, numRemoved, numNew, gaussians: this.#updated!.count }, [
      bufferOf(packed),
      ...(hidden ? [hidden.buffer as ArrayBuffer] : []),
    ]);
  }

  /** Requests the whole scene if its file was replaced, because the next update is not there. */
  async #reload(file: string): Promise<void> {
    const bytes = await readWhole(uncachedUrl(file), undefined, this.#updated!.digest);
    if (!bytes) return;
    const container = new ContainerReader(),
      packets = container.feed(bytes),
      { head } = container;
    if (!head) return;
    const stream = new DecodedStream(head, VERIFICATION),
      pause = periodicPause(),
      { elementDecoder } = this.#stream!.decoder;
    for (const packet of packets) {
      stream.addPacket(packet);
      await pause();
    }
    const { intake, elementDecoder: other } = stream.decoder,
      ratio = Math.max(other.size / elementDecoder.size, elementDecoder.size / other.size);
    if (head.manifest.codec !== "gaussians" || ratio > MAX_SIZE_RATIO || other.degree !== elementDecoder.degree)
      throw new Error("another scene: reload the page");
    if (!intake.complete || (await stream.decoder.digest(pause)) !== head.manifest.symbolsDigest)
      throw new Error("the scene is incomplete");
    if (!this.#followsUpdates) return; // the page wants no updates any more
    const before = this.#updated!.count;
    this.#updated = sceneOf(stream, fileManifest(bytes));
    this.#updatedFrom = stream;
    this.#sendUpdate(null, stream.splats, before, this.#updated.count);
  }

  /** Conceals losses once all received packets are decoded: those that wait are not lost. */
  async conceal({ simulation, requestId }: ToWorker & { kind: "conceal" }): Promise<void> {
    const pause = periodicPause(() => this.#concealRequest === requestId);
    this.#concealRequest = requestId;
    await this.#decoded();
    const stream = this.#stream;
    if (!stream || !(await pause())) return;
    if (this.#isUpdated) return this.#concealUpdated(simulation, requestId, pause);
    try {
      await stream.prepare(simulation, pause);
    } catch (error) {
      post({
        kind: "note",
        text: `Concealment failed: ${(error as Error).message}.`,
      });
      simulation = { ...simulation, concealer: "drop" };
    }
    await this.#send();
    const numKept = await stream.conceal(simulation, pause),
      units = [...this.#drawnUnits.keys()].sort((a, b) => a - b),
      gains = stream.decoder.elementDecoder.tiling ? stream.gainsOfUnits(units) : stream.gains;
    if (numKept === null || !gains) return;
    const gainsWithoutCopies = stream.gainsWithoutCopies;
    post({ kind: "gains", gains, gainsWithoutCopies, numKept, requestId }, buffersOfGains(gains, gainsWithoutCopies));
  }

  /**
   * Conceals losses in a scene that updates have changed. They are losses of the packets before the updates: an update
   * is applied as a whole.
   */
  async #concealUpdated(simulation: LossSimulation, requestId: number, pause: Pause): Promise<void> {
    const from = this.#updatedFrom!,
      numKeptOfStream = await from.conceal(simulation, pause);
    if (numKeptOfStream === null || from !== this.#updatedFrom) return;
    const gains = this.#updated!.gainsOfDrawn(from.gainsOfSplats),
      numKept = this.store.count - from.decoder.intake.size + numKeptOfStream;
    post({ kind: "gains", gains, gainsWithoutCopies: null, numKept, requestId }, buffersOfGains(gains));
  }

  /** Stops computing gains, because all packets have arrived. */
  cancelConcealment(): void {
    this.#concealRequest = 0;
  }

  /** True if every packet was received and decoded. */
  get complete(): boolean {
    return this.#stream?.decoder.intake.complete ?? false;
  }

  /** Reports whether the digest of all decoded integers is that of the manifest. */
  async digest(): Promise<void> {
    await this.#decoded();
    const stream = this.#stream,
      isVerified = await this.#isSameDigest();
    if (stream === this.#stream) this.#isVerified = isVerified;
    // A complete set of packets with a wrong digest is removed from the cache, so that the next visit starts fresh.
    if (!isVerified && (this.complete || this.store.complete)) await this.cache?.clear();
    post({ kind: "digest", isVerified });
  }

  async #isSameDigest(): Promise<boolean> {
    const decoder = this.#stream?.decoder;
    if (!decoder || this.#isVerified) return this.#isVerified;
    return (await decoder.digest(periodicPause())) === decoder.head.manifest.symbolsDigest;
  }

  get camera(): Camera | null {
    return this.#viewRequest && this.#stream?.decoder.elementDecoder.tiling ? this.#camera : null;
  }

  viewComplete(): void {
    void this.settled().then(() => {
      if (!this.#stream?.decoder.elementDecoder.tiling?.wanted.length) this.note(VIEW_COMPLETE);
    });
  }

  get tileRequest(): TileRequest | null {
    const stream = this.#stream,
      tiling = stream?.decoder.elementDecoder.tiling;
    if (!stream || !tiling) return null;
    const { intake } = stream.decoder,
      wanted = (): readonly number[] => (this.#viewRequest ? tiling.wanted : []); // none before the first camera
    return {
      head: stream.decoder.head,
      tiles: tiling.tiles,
      get wanted() {
        return wanted();
      },
      get packets() {
        return intake.size;
      },
      missing: (tile) => tiling.tiles.numPackets[tile] - (intake.blocks.get(tile)?.length ?? 0),
      nextView: async (isGivenUp) => {
        await this.#send();
        if (wanted().some((tile) => !isGivenUp(tile))) return; // the view has changed
        if (this.#counts) this.#reportCounts(this.#counts);
        if (this.#viewRequest) this.note(VIEW_COMPLETE);
        await new Promise<void>((resolve) => this.#viewWaiters.push(resolve));
      },
      decoded: async () => {
        await this.#decoded();
        await this.#send();
      },
    };
  }

  get begun(): boolean {
    return this.#stream !== null;
  }
}
