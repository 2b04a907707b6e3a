// `splatwire/decoder`: Gaussians out of streams, without a document: in node, in a worker or in a page.

import type { Viewpoint } from "./codec/decoder.ts";
import type { Splats } from "./codec/splats.ts";
import type { Camera } from "./model/camera.ts";
import { ContainerReader, type Head } from "./packets/container.ts";
import { receiveAll, sourceOf } from "./transport/attempts.ts";
import type { Arrived as ArrivedPacket } from "./transport/events.ts";
import { Held } from "./transport/held.ts";
import { Received } from "./transport/received.ts";
import type { Session } from "./transport/webtransport.ts";
import { nextTurn, pausing } from "./turns.ts";

export { BitstreamError } from "./bytes.ts";
export { Refused } from "./transport/refused.ts";
export type { Camera, Session, Viewpoint };

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
}

export interface Options {
  /** What hides losses (`grow`, `scene_free`, `sketch`); without one, what arrived is given as it is. */
  readonly concealer?: string;
  /** Where neural anchors are seen from: their Gaussians depend on it. Explicit Gaussians need none. */
  readonly camera?: Camera;
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
}

/** Gaussians in addition to those before or, with `instead`, in their place. */
export interface Arrived extends Progress {
  readonly gaussians: Gaussians;
  readonly instead: boolean;
}

export interface Scene extends Progress {
  readonly gaussians: Gaussians;
  /** Whether every packet is there. */
  readonly complete: boolean;
  /** Whether all decoded integers are those that were encoded; false where packets are lacking. */
  readonly verified: boolean;
  /** SHA-256 of all decoded integers, hexadecimal. */
  readonly digest: string;
}

/** Decodes the bytes of a `.swz` file. Throws `BitstreamError` where they are none. */
export async function decode(bytes: Uint8Array, options: Options = {}): Promise<Scene> {
  const container = new ContainerReader(),
    packets = container.feed(bytes),
    pause = pausing();
  if (!container.head) throw new Error("the file ends before its side information does");
  const received = new Received(container.head);
  for (const packet of packets) {
    received.take(packet);
    await pause();
  }
  const { decoder } = received,
    { complete } = decoder.intake,
    gaussians = await everything(received, options),
    digest = await decoder.digest(pause),
    verified = complete && digest === decoder.head.manifest.symbolsDigest;
  return { ...progressOf(received), gaussians, complete, verified, digest };
}

/**
 * Receives a stream: Gaussians as they arrive. With a concealer the last of what it gives has everything, concealed,
 * instead of what came before. A link that drops is tried again, and what is missing asked for.
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
    if (!received.hasNew) return;
    const seen = await received.seen(cameraOf(received, this.options), false, this.#pause);
    if (!seen) return;
    const gaussians = joined(seen.parts, received.decoder.antialiased);
    yield { ...progressOf(received), gaussians, instead: !this.#given };
    this.#given = true;
  }

  async *concealed(): AsyncGenerator<Arrived, void> {
    const received = this.#received;
    if (!received || !this.options.concealer) return;
    yield { ...progressOf(received), gaussians: await everything(received, this.options), instead: true };
  }

  stop(): void {
    this.#stopped = true;
  }

  end(error: unknown): void {
    this.ended = true;
    this.error = error;
    this.#wake();
  }

  preview(): void {}

  head(head: Head, file: Uint8Array): void {
    const known = this.#received?.decoder.head.manifest.streamId === head.manifest.streamId,
      received = known ? this.#received : new Received(head);
    if (!known || !this.held.begun) this.held.begin(file, head);
    if (known) return;
    this.#received = received;
    this.#waiting = [];
    this.#given = false;
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

/** All that is there, concealed if that is wanted. */
async function everything(received: Received, options: Options): Promise<Gaussians> {
  const pause = pausing(),
    { concealer } = options,
    { concealers } = received.decoder.schema,
    camera = cameraOf(received, options),
    choice = { concealer: concealer ?? "drop", dropped: 0, burst: 1, seed: 0, sent: 1 };
  if (concealer && !(concealer in concealers))
    throw new Error(`the stream has no concealer '${concealer}', only ${Object.keys(concealers).join(", ")}`);
  await received.prepare(choice, pause);
  const seen = await received.seen(camera, true, pause),
    all = joined(seen!.parts, received.decoder.antialiased);
  if (!concealer) return all;
  await received.conceal(choice, pause);
  return gained(all, received.gains!);
}

function cameraOf({ decoder }: Received, { camera }: Options): Camera {
  if (camera) return camera;
  if (decoder.schema.viewDependent)
    throw new Error("the stream has neural anchors: say with `camera` who looks at them");
  return { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };
}

const progressOf = ({ decoder }: Received): Progress => ({
  packets: decoder.intake.size,
  expected: decoder.head.manifest.numPackets,
  background: decoder.background,
  viewpoint: decoder.viewpoint,
});

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

function joined(parts: readonly Splats[], antialiased: boolean): Gaussians {
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
    degree: parts[0]?.degree ?? 0,
    centres: all(parts.map(({ means }) => means)),
    rotations: all(parts.map(({ quats }) => quats)),
    scales: all(parts.map(({ scales }) => scales)),
    opacities: all(parts.map(({ opacities }) => opacities)),
    colours: all(parts.map(({ colours }) => colours)),
    harmonics: all(parts.map(({ harmonics }) => harmonics)),
    antialiased,
  };
}
