// `splatwire/decoder`: Gaussians out of streams, without a document: in node, in a worker or in a page.

import { BitstreamError } from "./bytes.ts";
import type { StreamDecoder, Viewpoint } from "./codec/decoder.ts";
import type { Tiling } from "./codec/levels/tiling.ts";
import type { Schema } from "./codec/schema.ts";
import type { Splats } from "./codec/splats.ts";
import type { Camera } from "./model/camera.ts";
import { ContainerReader, type Head } from "./packets/container.ts";
import { receiveAll, sourceOf } from "./transport/attempts.ts";
import type { Arrived as ArrivedPacket } from "./transport/events.ts";
import { Held } from "./transport/held.ts";
import { Received } from "./transport/received.ts";
import type { Session } from "./transport/webtransport.ts";
import { nextTurn, type Pause, pausing } from "./turns.ts";

export { Refused } from "./transport/refused.ts";
export type { Camera, Session, Viewpoint };
export { BitstreamError };

/** Explicit Gaussians, one after another in typed arrays. */
export interface Gaussians {
  readonly count: number;
  /** Degree of the spherical harmonics, 0 to 3. */
  readonly degree: number;
  /** x, y, z of each, world units. */
  readonly centres: Float32Array;
  /** Unit quaternions w, x, y, z. */
  readonly rotations: Float32Array;
  /** Standard deviations along the three axes, world units. */
  readonly scales: Float32Array;
  /** From 0 to 1. */
  readonly opacities: Float32Array;
  /** Red, green, blue as seen from everywhere: 0.5 + 0.28209 times the coefficient of degree 0. */
  readonly colours: Float32Array;
  /** Coefficients of degree 1 and more: coefficient after coefficient of a Gaussian, three channels each. */
  readonly harmonics: Float32Array;
  /** Whether they lose opacity as they are widened to a pixel (Mip-Splatting), not so in 3DGS. */
  readonly antialiased: boolean;
  /** World coordinates that `centres` are relative to, of geo-referenced scenes; else 0, 0, 0. */
  readonly origin: readonly [number, number, number];
}

export interface Options {
  /**
   * Hides losses: `grow` for every stream; `scene_free` and `sketch` where the stream has them; `motion`, `hold` and
   * `drop` for clips, where `grow` is `motion`. Without one, elements that arrived are given as they are. In streams
   * with levels coarser Gaussians always stand in for finer ones that were lost.
   */
  readonly concealer?: string;
  /** View for neural anchors: their Gaussians depend on it. Explicit Gaussians need none. */
  readonly camera?: Camera;
  /** Frame of a clip, from 0. Clips need it, other streams have none. */
  readonly frame?: number;
}

/** Timing of a clip. */
export interface Clip {
  /** Frames per second. */
  readonly rate: number;
  readonly numFrames: number;
}

export interface ReceiveOptions extends Options {
  /** WebTransport sessions of the server, if they are not what `../streams.json` beside the file says. */
  readonly session?: Session;
  /** Ends the transfer; the iteration then throws its reason. */
  readonly signal?: AbortSignal;
  /** Told why the link dropped, and after how many milliseconds it is tried again. */
  readonly lost?: (reason: string, retryMs: number) => void;
}

/** What a stream brought so far. */
export interface Progress {
  readonly packets: number;
  readonly expected: number;
  /** RGB behind the scene, each from 0 to 1. */
  readonly background: readonly [number, number, number];
  /** Where the scene is looked at first, if the stream says it. */
  readonly viewpoint: Viewpoint | null;
  /** Null where nothing moves. */
  readonly clip: Clip | null;
}

/** Gaussians in addition to those before or, with `instead`, in their place. */
export interface Arrived extends Progress {
  readonly gaussians: Gaussians;
  readonly instead: boolean;
}

/** Facts about a whole file. */
export interface Decoded extends Progress {
  /** True if every packet is there. */
  readonly complete: boolean;
  /** True if all decoded integers are those that were encoded; false where packets are missing. */
  readonly verified: boolean;
  /** SHA-256 of all decoded integers, hexadecimal. */
  readonly digest: string;
}

export interface Scene extends Decoded {
  /** All Gaussians of the scene, of levels the finest ones; of a clip those of one frame. */
  readonly gaussians: Gaussians;
}

export interface DecodedClip extends Decoded {
  readonly clip: Clip;
  /** Gaussians of a frame, from 0. Throws `RangeError` where the clip has no such frame. */
  frame(number: number): Gaussians;
}

/**
 * Decodes the bytes of a `.swz` file. Throws `BitstreamError` where they are none, and `RangeError` for a clip without
 * the option `frame`.
 */
export async function decode(bytes: Uint8Array, options: Options = {}): Promise<Scene> {
  const received = await read(bytes);
  checkOptions(received, options);
  const gaussians = await everything(received, options);
  return { ...(await checked(received)), gaussians };
}

/** Decodes the bytes of a clip once, for any of its frames. Throws `BitstreamError` where they are none. */
export async function decodeClip(bytes: Uint8Array, options: Pick<Options, "concealer"> = {}): Promise<DecodedClip> {
  const received = await read(bytes),
    { moving } = received.decoder.schema;
  if (!moving) throw new Error("the stream is not a clip: `decode` gives its Gaussians");
  checkOptions(received, { ...options, frame: 0 });
  const facts = await checked(received),
    frame = (number: number): Gaussians => {
      checkOptions(received, { ...options, frame: number });
      return frameOf(received, { ...options, frame: number });
    };
  return { ...facts, clip: facts.clip!, frame };
}

/** Takes all packets of a file. */
async function read(bytes: Uint8Array): Promise<Received> {
  const container = new ContainerReader(),
    packets = container.feed(bytes),
    pause = pausing();
  if (!container.head) throw new BitstreamError("the file ends before its side information does");
  const received = new Received(container.head);
  for (const packet of packets) {
    received.take(packet);
    await pause();
  }
  return received;
}

/** Compares all integers with the digest of the manifest. */
async function checked(received: Received): Promise<Decoded> {
  const { decoder } = received,
    { complete } = decoder.intake,
    digest = await decoder.digest(pausing()),
    verified = complete && digest === decoder.head.manifest.symbolsDigest;
  return { ...progressOf(received), complete, verified, digest };
}

/** How much more has to arrive of levels or a clip until all that is drawn is given anew. */
const GROWTH = 1.5;

/**
 * Receives a stream: Gaussians as they arrive. With a concealer the last of what it gives has everything, concealed,
 * instead of what came before. Of levels and clips each result replaces the one before. A link that drops is tried
 * again, and what is missing asked for. A live clip is refused: it has no last packet.
 */
export async function* receive(url: string | URL, options: ReceiveOptions = {}): AsyncGenerator<Arrived, void> {
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
    await Promise.race([ended, nextTurn()]);
  }
}

class Transfer {
  readonly held = new Held();
  readonly live = false;
  ended = false;
  error: unknown = null;
  #received: Received | null = null;
  #given = false;
  /** Packets of which the last result was made, of streams whose results replace each other. */
  #shown = 0;
  #waiting: ArrivedPacket[] = [];
  #wake: () => void = () => undefined;
  #stopped = false;
  readonly #pause = pausing();

  constructor(readonly options: ReceiveOptions) {
    options.signal?.addEventListener("abort", () => this.#wake());
  }

  /** Resolves when there is something to decode, or nothing will come any more. */
  more(): Promise<void> {
    if (this.#waiting.length || this.ended || this.stopped()) return Promise.resolve();
    return new Promise((resolve) => (this.#wake = resolve));
  }

  /** Decodes what waits. */
  async *taken(): AsyncGenerator<Arrived, void> {
    const received = this.#received,
      waiting = this.#waiting.splice(0);
    if (!received) return;
    for (const { bytes } of waiting) {
      received.take(bytes);
      await this.#pause();
    }
    if (replaces(received)) return yield* this.#replaced(received);
    if (!received.hasNew) return;
    const seen = await received.seen(cameraOf(this.options), false, this.#pause);
    if (!seen) return;
    const gaussians = joined(seen.parts, received.decoder);
    yield { ...progressOf(received), gaussians, instead: !this.#given };
    this.#given = true;
  }

  /** Everything anew, where enough more arrived or nothing more will. */
  async *#replaced(received: Received): AsyncGenerator<Arrived, void> {
    const { size } = received.decoder.intake;
    if (this.#given && size === this.#shown) return;
    if (!this.ended && size < GROWTH * this.#shown) return;
    const gaussians = await everything(received, this.options);
    this.#shown = size;
    if (!gaussians.count && !this.ended) return;
    this.#given = true;
    yield { ...progressOf(received), gaussians, instead: true };
  }

  async *concealed(): AsyncGenerator<Arrived, void> {
    const received = this.#received;
    if (!received || !this.options.concealer || replaces(received)) return;
    yield { ...progressOf(received), gaussians: await everything(received, this.options), instead: true };
  }

  stop(): void {
    this.#stopped = true;
  }

  end(error: unknown): void {
    if (this.ended) return;
    this.ended = true;
    this.error = error;
    this.#wake();
  }

  preview(): void {}

  head(head: Head, file: Uint8Array, _keep: boolean, live = false): void {
    const known = this.#received?.decoder.head.manifest.streamId === head.manifest.streamId,
      received = known ? this.#received : new Received(head);
    if (!known || !this.held.begun) this.held.begin(file, head);
    if (known) return;
    try {
      if (live) throw new Error("the stream is a live clip, which only the element `<splat-wire>` plays");
      checkOptions(received!, this.options);
    } catch (error) {
      this.end(error);
      return this.stop(); // trying again would not help
    }
    this.#received = received;
    this.#waiting = [];
    this.#given = false;
    this.#shown = 0;
  }

  packets(packets: readonly ArrivedPacket[]): void {
    this.#waiting.push(...this.held.add(packets));
    this.#wake();
  }

  counts(): void {}

  note(): void {}

  lost(reason: string, retryMs: number): void {
    this.options.lost?.(reason, retryMs);
  }

  stopped(): boolean {
    return this.#stopped || this.options.signal?.aborted === true;
  }
}

/** True for streams of which Gaussians that arrive take the place of others: levels and clips. */
const replaces = ({ decoder: { schema } }: Received): boolean => schema.tiling !== null || schema.moving !== null;

/** Throws where a stream cannot be decoded with these options. */
function checkOptions({ decoder: { schema } }: Received, { concealer, camera, frame }: Options): void {
  const { moving, tiling, concealers, viewDependent } = schema,
    levels = ["grow", "drop"],
    known = moving ? ["grow", ...moving.concealers] : tiling ? levels : ["drop", ...Object.keys(concealers)];
  if (concealer && !known.includes(concealer))
    throw new Error(`the stream has no concealer '${concealer}', only ${[...new Set(known)].join(", ")}`);
  if (moving) {
    const { numFrames } = moving.times,
      range = `0 to ${numFrames - 1}`;
    if (frame === undefined)
      throw new RangeError(`the stream is a clip: choose one of its frames, ${range}, with \`frame\``);
    if (!(Number.isInteger(frame) && frame >= 0 && frame < numFrames))
      throw new RangeError(`there is no frame ${frame}: the clip has frames ${range}`);
  } else if (frame !== undefined) throw new RangeError(`there is no frame ${frame}: the stream is not a clip`);
  if (viewDependent && !tiling && !camera)
    throw new Error("the stream has neural anchors, whose Gaussians depend on the view: pass a `camera`");
}

/** All that is there, concealed if that is wanted. */
async function everything(received: Received, options: Options): Promise<Gaussians> {
  const pause = pausing(),
    { concealer } = options,
    schema = received.decoder.schema,
    choice = { concealer: concealer ?? "drop", dropped: 0, burst: 1, seed: 0, sent: 1 };
  if (schema.moving) return frameOf(received, options);
  if (schema.tiling) return joined(await finest(schema.tiling, pause), received.decoder);
  await received.prepare(choice, pause);
  const seen = await received.seen(cameraOf(options), true, pause),
    all = joined(seen!.parts, received.decoder);
  if (!concealer) return all;
  await received.conceal(choice, pause);
  return gained(all, received.gains!);
}

/** The finest tiles that are there, coarser ones in place of those that are not. */
async function finest(tiling: Tiling, pause: Pause): Promise<Splats[]> {
  const parts: Splats[] = [];
  tiling.look(null, Infinity);
  for (const piece of tiling.drawn) {
    await pause();
    parts.push(...tiling.splatsOf(piece));
  }
  return parts;
}

const ALL_SHOWN = (): boolean => true;

function frameOf({ decoder }: Received, { frame, concealer = "drop" }: Options): Gaussians {
  const name = concealer === "grow" ? "motion" : concealer,
    { splats } = decoder.schema.moving!.frame(frame!, ALL_SHOWN, name);
  return joined([splats], decoder);
}

/** Explicit Gaussians look the same to every camera. */
const cameraOf = ({ camera }: Options): Camera => camera ?? { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };

const progressOf = ({ decoder }: Received): Progress => ({
  packets: decoder.intake.size,
  expected: decoder.head.manifest.numPackets,
  background: decoder.background,
  viewpoint: decoder.viewpoint,
  clip: clipOf(decoder.schema),
});

function clipOf({ moving }: Schema): Clip | null {
  return moving && { rate: moving.times.rate, numFrames: moving.times.numFrames };
}

/** Gaussians with gains of size and opacity in turn; those of size 0 are left out. */
function gained(all: Gaussians, gains: Float32Array): Gaussians {
  const kept = Array.from({ length: all.count }, (_, n) => n).filter((n) => gains[2 * n] > 0),
    some = (values: Float32Array, change: (value: number, n: number) => number = (value) => value): Float32Array => {
      const width = values.length / Math.max(all.count, 1),
        found = new Float32Array(width * kept.length);
      for (const [to, n] of kept.entries())
        for (let a = 0; a < width; a++) found[to * width + a] = change(values[n * width + a], n);
      return found;
    };
  return {
    ...all,
    count: kept.length,
    centres: some(all.centres),
    rotations: some(all.rotations),
    scales: some(all.scales, (value, n) => value * gains[2 * n]),
    opacities: some(all.opacities, (value, n) => Math.min(value * gains[2 * n + 1], 1)),
    colours: some(all.colours),
    harmonics: some(all.harmonics),
  };
}

function joined(parts: readonly Splats[], { antialiased, origin, schema }: StreamDecoder): Gaussians {
  const all = (arrays: readonly Float32Array[]): Float32Array => {
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
    degree: schema.degree,
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
