// `splatwire/decoder`: decodes streams to Gaussians without a document. Runs in node, in workers and in pages.

import { BitstreamError } from "./bytes.ts";
import type { StreamDecoder, Viewpoint } from "./codec/decoder.ts";
import type { ElementDecoder } from "./codec/element_decoder.ts";
import type { Tiling } from "./codec/levels/tiling.ts";
import type { Splats } from "./codec/splats.ts";
import { ANY_CAMERA, type Camera, checkCamera } from "./model/camera.ts";
import { ContainerReader, type Head } from "./packets/container.ts";
import { nextTask, type Pause, periodicPause } from "./scheduler.ts";
import { DecodedStream } from "./transport/decoded_stream.ts";
import type { ReceivedPacket } from "./transport/events.ts";
import { receiveAll, sourceOf } from "./transport/failover.ts";
import { PacketStore } from "./transport/packet_store.ts";
import type { SessionAddress } from "./transport/webtransport.ts";

/** `Refused` is the deprecated name of `HttpError`. */
export { HttpError, HttpError as Refused } from "./transport/http_error.ts";
export type { Camera, SessionAddress, Viewpoint };

/** @deprecated Use `SessionAddress`. */
export type Session = SessionAddress;
export { BitstreamError };

/** Explicit Gaussians in typed arrays, one Gaussian after another. */
export interface Gaussians {
  readonly count: number;
  /** Degree of the spherical harmonics, 0 to 3. */
  readonly degree: number;
  /** Centres x, y, z, shape (count, 3), world units. `origin` is not included. */
  readonly centres: Float32Array;
  /** Unit quaternions w, x, y, z, shape (count, 4). */
  readonly rotations: Float32Array;
  /** Standard deviations along the three axes, shape (count, 3), world units. */
  readonly scales: Float32Array;
  /** Opacities, shape (count), 0 to 1. */
  readonly opacities: Float32Array;
  /** RGB without the view-dependent part, shape (count, 3): 0.5 + 0.28209 times the coefficient of degree 0. */
  readonly colours: Float32Array;
  /** Coefficients of degree 1 and above, shape (count, (degree + 1)^2 - 1, 3). The last axis is RGB. */
  readonly harmonics: Float32Array;
  /** True if opacity decreases for Gaussians below the size of a pixel (Mip-Splatting), as opposed to 3DGS. */
  readonly antialiased: boolean;
  /** World coordinates of the point that `centres` are relative to. It is 0, 0, 0 unless the scene is georeferenced. */
  readonly origin: readonly [number, number, number];
}

export interface Options {
  /**
   * Concealment method. `grow` works for every stream; `scene_free` and `sketch` need a stream that offers them. Clips
   * offer `motion`, `hold` and `drop`; for clips, `grow` means `motion`. Without a concealer, the received elements are
   * returned unchanged. In streams with levels, coarser Gaussians always replace lost finer ones.
   */
  readonly concealer?: string;
  /**
   * Camera for neural anchors: their Gaussians depend on the view. Explicit Gaussians need none. `margin` is 0 by
   * default.
   */
  readonly camera?: Omit<Camera, "margin"> & { readonly margin?: number };
  /** Frame of a clip, from 0. Required for clips, an error for other streams. */
  readonly frame?: number;
}

/** Timing of a clip. */
export interface Clip {
  /** Frames per second. */
  readonly rate: number;
  readonly numFrames: number;
}

export interface ReceiveOptions extends Options {
  /**
   * Address of the server's WebTransport sessions. The default is the one that `../streams.json`, relative to the file,
   * names.
   */
  readonly session?: SessionAddress;
  /** Aborts the transfer. The iteration then throws the signal's reason. */
  readonly signal?: AbortSignal;
  /** Callback after a disconnect, with the reason and the time until the next attempt in milliseconds. */
  readonly lost?: (reason: string, retryMs: number) => void;
}

/** State of a stream so far. */
export interface Progress {
  readonly packets: number;
  readonly expected: number;
  /** Background colour, RGB, each 0 to 1. */
  readonly background: readonly [number, number, number];
  /** Initial view; null if the stream has none. */
  readonly viewpoint: Viewpoint | null;
  /** Timing of a clip; null for static scenes. */
  readonly clip: Clip | null;
}

/** Newly decoded Gaussians. They replace all earlier ones if `replaces` is true, and are added to them otherwise. */
export interface ReceivedUpdate extends Progress {
  readonly gaussians: Gaussians;
  readonly replaces: boolean;
  /** @deprecated Former name of `replaces`. */
  readonly instead: boolean;
}

/** Results of decoding a whole file. */
export interface Decoded extends Progress {
  /** True if every packet was received. */
  readonly complete: boolean;
  /** True if all decoded integers equal the encoded ones. False if packets are missing. */
  readonly verified: boolean;
  /** SHA-256 of all decoded integers, hexadecimal. */
  readonly digest: string;
}

export interface Scene extends Decoded {
  /** All Gaussians of the scene: the finest level of a stream with levels, or one frame of a clip. */
  readonly gaussians: Gaussians;
}

export interface DecodedClip extends Decoded {
  readonly clip: Clip;
  /** Returns the Gaussians of a frame, from 0. Throws `RangeError` if the clip has no such frame. */
  frame(number: number): Gaussians;
}

/**
 * Decodes a `.swz` file.
 *
 * Throws `BitstreamError` if the bytes are not a stream, and `RangeError` if a clip is decoded without `frame`.
 */
export async function decode(bytes: Uint8Array | ArrayBuffer, options: Options = {}): Promise<Scene> {
  const received = await read(bytes);
  checkOptions(received, options);
  const gaussians = await everything(received, options);
  return { ...(await checked(received)), gaussians };
}

/** Decodes a clip once and gives access to all its frames. Throws `BitstreamError` if the bytes are not a stream. */
export async function decodeClip(
  bytes: Uint8Array | ArrayBuffer,
  options: Pick<Options, "concealer"> = {},
): Promise<DecodedClip> {
  const received = await read(bytes),
    { sequence } = received.decoder.elementDecoder;
  if (!sequence) throw new Error("the stream is not a clip: `decode` gives its Gaussians");
  checkOptions(received, { ...options, frame: 0 });
  const facts = await checked(received),
    frame = (number: number): Gaussians => {
      checkOptions(received, { ...options, frame: number });
      return frameOf(received, { ...options, frame: number });
    };
  return { ...facts, clip: facts.clip!, frame };
}

/** Returns the bytes of a file. Throws `TypeError` for anything else, such as a `Response` or a `Blob`. */
function bytesOf(file: unknown): Uint8Array {
  if (file instanceof Uint8Array) return file;
  // buffers of other documents and threads are not instances of this one's class
  if (Object.prototype.toString.call(file) === "[object ArrayBuffer]") return new Uint8Array(file as ArrayBuffer);
  if (ArrayBuffer.isView(file)) return new Uint8Array(file.buffer, file.byteOffset, file.byteLength);
  throw new TypeError("the decoder takes the bytes of a `.swz` file as a Uint8Array or an ArrayBuffer");
}

/** Decodes all packets of a file. */
async function read(file: Uint8Array | ArrayBuffer): Promise<DecodedStream> {
  const bytes = bytesOf(file),
    container = new ContainerReader(),
    packets = container.feed(bytes),
    pause = periodicPause();
  if (!container.head) throw new BitstreamError("the file ends before its side information does");
  const received = new DecodedStream(container.head, { keptBytes: 0, fileBytes: bytes.length });
  for (const packet of packets) {
    received.addPacket(packet);
    await pause();
  }
  return received;
}

/** Compares the decoded integers with the digest of the manifest. */
async function checked(received: DecodedStream): Promise<Decoded> {
  const { decoder } = received,
    { complete } = decoder.intake,
    digest = await decoder.digest(periodicPause()),
    verified = complete && digest === decoder.head.manifest.symbolsDigest;
  return { ...progressOf(received), complete, verified, digest };
}

/**
 * Factor of received packets between two results of a stream with levels or a clip. Each result repeats the whole
 * scene.
 */
const GROWTH = 1.5;

/**
 * Receives a stream and yields Gaussians as they arrive.
 *
 * With a concealer, the last result is the whole concealed scene and replaces the earlier ones. For streams with levels
 * and for clips, every result replaces the one before. After a disconnect, the transfer continues with the missing
 * packets. A server that does not answer is tried again until `signal` is aborted. Throws for live clips, which have no
 * last packet.
 */
export async function* receive(url: string | URL, options: ReceiveOptions = {}): AsyncGenerator<ReceivedUpdate, void> {
  const transfer = new Transfer(options);
  const ended = sourceOf(new URL(url, globalThis.location?.href), options.session ?? null)
    .then((source) => receiveAll(source, transfer))
    .then(
      () => transfer.end(null),
      (error: unknown) => transfer.end(error),
    );
  try {
    for (;;) {
      await transfer.more();
      const over = transfer.ended;
      yield* transfer.taken();
      options.signal?.throwIfAborted();
      if (over) break;
    }
    if (transfer.error) throw transfer.error;
    yield* transfer.concealed();
  } finally {
    transfer.stop();
    await Promise.race([ended, nextTask()]);
  }
}

class Transfer {
  readonly store = new PacketStore();
  readonly live = false;
  numReceived = 0;
  ended = false;
  error: unknown = null;
  #received: DecodedStream | null = null;
  #given = false;
  /** Number of packets in the last result, for streams with results that replace each other. */
  #shown = 0;
  #waiting: ReceivedPacket[] = [];
  #wake: () => void = () => undefined;
  #stopped = false;
  readonly #pause = periodicPause();
  /** Aborts the listener: a signal may live longer than the transfer, and would keep its Gaussians. */
  readonly #listening = new AbortController();

  constructor(readonly options: ReceiveOptions) {
    options.signal?.addEventListener("abort", () => this.#wake(), { signal: this.#listening.signal });
  }

  /** Resolves once packets are waiting to be decoded or the transfer has ended. */
  more(): Promise<void> {
    if (this.#waiting.length || this.ended || this.stopped()) return Promise.resolve();
    return new Promise((resolve) => (this.#wake = resolve));
  }

  /** Decodes the waiting packets and yields the result. */
  async *taken(): AsyncGenerator<ReceivedUpdate, void> {
    const received = this.#received,
      waiting = this.#waiting.splice(0);
    if (!received) return;
    for (const { bytes } of waiting) {
      received.addPacket(bytes);
      await this.#pause();
    }
    if (replaces(received)) return yield* this.#replaced(received);
    if (!received.hasNew) return;
    const seen = await received.gaussiansFor(cameraOf(this.options), false, this.#pause);
    if (!seen) return;
    const gaussians = joined(seen.parts, received.decoder);
    yield updateOf(received, gaussians, !this.#given);
    this.#given = true;
  }

  /** Yields the whole scene if enough new packets arrived or the transfer has ended. */
  async *#replaced(received: DecodedStream): AsyncGenerator<ReceivedUpdate, void> {
    const { size } = received.decoder.intake;
    if (this.#given && size === this.#shown) return;
    if (!this.ended && size < GROWTH * this.#shown) return;
    const gaussians = await everything(received, this.options);
    this.#shown = size;
    if (!gaussians.count && !this.ended) return;
    this.#given = true;
    yield updateOf(received, gaussians, true);
  }

  async *concealed(): AsyncGenerator<ReceivedUpdate, void> {
    const received = this.#received;
    if (!received || !this.options.concealer || replaces(received)) return;
    yield updateOf(received, await everything(received, this.options), true);
  }

  stop(): void {
    this.#stopped = true;
    this.#listening.abort();
  }

  end(error: unknown): void {
    if (this.ended) return;
    this.ended = true;
    this.error = error;
    this.#wake();
  }

  preview(): void {}

  head(head: Head, fileHead: Uint8Array, _keep: boolean, live = false): void {
    const before = this.#received?.decoder.head.manifest,
      known = before?.streamId === head.manifest.streamId && (!this.store.hasHead || this.store.isSame(fileHead)),
      received = known ? this.#received : new DecodedStream(head);
    if (!known || !this.store.hasHead) this.store.begin(fileHead, head);
    if (known) return;
    try {
      if (live)
        throw new Error("the stream is a live clip: `Clip` of `splatwire/clip` and the element `<splat-wire>` play it");
      checkOptions(received!, this.options);
    } catch (error) {
      this.end(error);
      return this.stop(); // a retry cannot help
    }
    this.#received = received;
    this.#waiting = [];
    this.#given = false;
    this.#shown = 0;
  }

  packets(packets: readonly ReceivedPacket[]): void {
    const added = this.store.add(packets);
    this.numReceived += added.length;
    this.#waiting.push(...added);
    this.#wake();
  }

  counts(): void {}

  note(): void {}

  disconnected(reason: string, retryMs: number): void {
    this.options.lost?.(reason, retryMs);
  }

  stopped(): boolean {
    return this.#stopped || this.options.signal?.aborted === true;
  }
}

/** Returns true if new Gaussians replace earlier ones, as in streams with levels and in clips. */
const replaces = ({ decoder: { elementDecoder } }: DecodedStream): boolean =>
  elementDecoder.tiling !== null || elementDecoder.sequence !== null;

/** Throws if the stream cannot be decoded with these options. */
function checkOptions({ decoder: { elementDecoder } }: DecodedStream, { concealer, camera, frame }: Options): void {
  const { sequence, tiling, concealers, viewDependent } = elementDecoder,
    levels = ["grow", "drop"],
    known = sequence ? ["grow", ...sequence.concealers] : tiling ? levels : ["drop", ...Object.keys(concealers)];
  if (concealer && !known.includes(concealer))
    throw new Error(`the stream has no concealer '${concealer}', only ${[...new Set(known)].join(", ")}`);
  if (sequence) {
    const { numFrames } = sequence.timeline,
      range = `0 to ${numFrames - 1}`;
    if (frame === undefined)
      throw new RangeError(`the stream is a clip: choose one of its frames, ${range}, with \`frame\``);
    if (!(Number.isInteger(frame) && frame >= 0 && frame < numFrames))
      throw new RangeError(`frame ${frame} does not exist: the clip has frames ${range}`);
  } else if (frame !== undefined)
    throw new RangeError(`the option \`frame\` is ${frame}, but the stream is not a clip`);
  if (viewDependent && !tiling && !camera)
    throw new Error("the stream has neural anchors, whose Gaussians depend on the view: pass a `camera`");
  if (viewDependent && camera) checkCamera(camera);
}

/** Returns all received Gaussians, concealed if a concealer is chosen. */
async function everything(received: DecodedStream, options: Options): Promise<Gaussians> {
  const pause = periodicPause(),
    { concealer } = options,
    elementDecoder = received.decoder.elementDecoder,
    simulation = { concealer: concealer ?? "drop", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };
  if (elementDecoder.sequence) return frameOf(received, options);
  if (elementDecoder.tiling) return joined(await finest(elementDecoder.tiling, pause), received.decoder);
  await received.prepare(simulation, pause);
  const seen = await received.gaussiansFor(cameraOf(options), true, pause),
    all = joined(seen!.parts, received.decoder);
  if (!concealer) return all;
  await received.conceal(simulation, pause);
  return gained(all, received.gains!);
}

/** Returns the finest received tiles. Coarser tiles replace the missing ones. */
async function finest(tiling: Tiling, pause: Pause): Promise<Splats[]> {
  const parts: Splats[] = [];
  tiling.setCamera(null, Infinity);
  for (const unit of tiling.drawn) {
    await pause();
    parts.push(...tiling.splatsOf(unit));
  }
  return parts;
}

const ALL_SHOWN = (): boolean => true;

function frameOf({ decoder }: DecodedStream, { frame, concealer = "drop" }: Options): Gaussians {
  const name = concealer === "grow" ? "motion" : concealer,
    { splats } = decoder.elementDecoder.sequence!.frame(frame!, ALL_SHOWN, name);
  return joined([splats], decoder);
}

/** Camera of the options. The default camera is for explicit Gaussians, which do not depend on the view. */
const cameraOf = ({ camera }: Options): Camera => (camera ? { ...camera, margin: camera.margin ?? 0 } : ANY_CAMERA);

const updateOf = (received: DecodedStream, gaussians: Gaussians, replaces: boolean): ReceivedUpdate => ({
  ...progressOf(received),
  gaussians,
  replaces,
  instead: replaces,
});

const progressOf = ({ decoder }: DecodedStream): Progress => ({
  packets: decoder.intake.size,
  expected: decoder.head.manifest.numPackets,
  background: decoder.background,
  viewpoint: decoder.viewpoint,
  clip: sequenceOf(decoder.elementDecoder),
});

function sequenceOf({ sequence }: ElementDecoder): Clip | null {
  return sequence && { rate: sequence.timeline.rate, numFrames: sequence.timeline.numFrames };
}

/** Multiplies sizes and opacities by `gains`, shape (count, 2), and removes Gaussians with a size gain of 0. */
function gained(all: Gaussians, gains: Float32Array): Gaussians {
  const drawn = Array.from({ length: all.count }, (_, n) => n).filter((n) => gains[2 * n] > 0),
    some = (values: Float32Array, change: (value: number, n: number) => number = (value) => value): Float32Array => {
      const width = values.length / Math.max(all.count, 1),
        found = new Float32Array(width * drawn.length);
      for (const [to, n] of drawn.entries())
        for (let a = 0; a < width; a++) found[to * width + a] = change(values[n * width + a], n);
      return found;
    };
  return {
    ...all,
    count: drawn.length,
    centres: some(all.centres),
    rotations: some(all.rotations),
    scales: some(all.scales, (value, n) => value * gains[2 * n]),
    opacities: some(all.opacities, (value, n) => Math.min(value * gains[2 * n + 1], 1)),
    colours: some(all.colours),
    harmonics: some(all.harmonics),
  };
}

/** True if these are several arrays that lie one after another in one buffer and fill it. */
function areWhole(arrays: readonly Float32Array[]): boolean {
  if (arrays.length < 2) return false;
  const { buffer } = arrays[0];
  let at = 0;
  for (const array of arrays) {
    if (array.buffer !== buffer || array.byteOffset !== at) return false;
    at += array.byteLength;
  }
  return at === buffer.byteLength;
}

function joined(parts: readonly Splats[], { antialiased, origin, elementDecoder }: StreamDecoder): Gaussians {
  const all = (arrays: readonly Float32Array[]): Float32Array => {
    if (areWhole(arrays)) return new Float32Array(arrays[0].buffer as ArrayBuffer);
    const found = new Float32Array(arrays.reduce((sum, array) => sum + array.length, 0));
    let at = 0;
    for (const array of arrays) {
      found.set(array, at);
      at += array.length;
    }
    return found;
  };
  return {
    count: parts.reduce((sum, part) => sum + part.count, 0),
    degree: elementDecoder.degree,
    centres: all(parts.map(({ means }) => means)),
    rotations: all(parts.map(({ quats }) => quats)),
    scales: all(parts.map(({ scales }) => scales)),
    opacities: all(parts.map(({ opacities }) => opacities)),
    colours: all(parts.map(({ colours }) => colours)),
    harmonics: all(parts.map(({ harmonics }) => harmonics)),
    antialiased,
    origin,
  };
}
