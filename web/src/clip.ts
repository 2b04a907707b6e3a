// `splatwire/clip`: plays clips and live clips in other renderers. A worker receives and decodes; the renderer takes
// the due frame once per picture.

import startReceiver, { notStarted } from "worker:receiver";
import type { Viewpoint } from "./codec/decoder.ts";
import { ClipClock, type FrameClock, LiveClock } from "./frame_clock.ts";
import type { ListenerMethod } from "./listener_method.ts";
import type { Packed } from "./render/packed.ts";
import { sourceOf } from "./transport/failover.ts";
import type { FromWorker, StreamInfo, ToWorker } from "./transport/messages.ts";
import type { SessionAddress } from "./transport/webtransport.ts";

export type { SessionAddress, Viewpoint };

/** @deprecated Use `SessionAddress`. */
export type Session = SessionAddress;

export interface ClipOptions {
  /** Name of the concealer: `motion` (default), `hold` or `drop`. */
  readonly concealer?: string;
  /**
   * Address of the server's WebTransport sessions. The default is the one that `../streams.json`, relative to the file,
   * names.
   */
  readonly session?: SessionAddress;
  /** Aborts `Clip.open`, which waits for a server without end. Without effect later. */
  readonly signal?: AbortSignal;
}

/** Interval at which a playing clip checks whether it has ended, milliseconds: a hidden page takes no frames. */
const CHECK_MS = 250;

/** A decoded frame, in the layout of GPU textures. */
export interface ClipFrame {
  /** Number of the frame, from 0. */
  readonly number: number;
  /** Gaussians. Lengths are in units of `Clip.size`. */
  readonly packed: Packed;
}

/** Events of a clip by name. The `detail` of `lost` and `error` is the reason. */
export interface ClipEvents {
  readonly ended: CustomEvent<null>;
  readonly lost: CustomEvent<string>;
  readonly error: CustomEvent<string>;
}

/** Properties of a stream that do not change. */
type SequenceStreamInfo = StreamInfo & { readonly sequence: NonNullable<StreamInfo["sequence"]> };

/**
 * A clip that is being received and played. It starts paused, unless it is live.
 *
 * Events: `ended` after the last frame; `lost` after a disconnect, before the next attempt; `error` if the clip cannot
 * be received. The `detail` of `lost` and `error` is the reason, a string.
 */
export class Clip extends EventTarget {
  declare addEventListener: ListenerMethod<Clip, ClipEvents, AddEventListenerOptions>;
  declare removeEventListener: ListenerMethod<Clip, ClipEvents, EventListenerOptions>;
  /** True if playback continues with the first frame after the last one. Without effect on live clips. */
  loop = false;
  readonly #clock: FrameClock;
  #paused = true;
  /** Checks the end while the clip plays. */
  #checks: ReturnType<typeof setInterval> | undefined;
  /** Last arrived frame, until `update` returns it. */
  #arrived: ClipFrame | null = null;
  /** Number of the frame that arrived last, also if it was empty; -1 before the first one. */
  #received = -1;
  /** Requested frame that has not arrived; -1 if none. */
  #requested = -1;
  /** True if the frame must be requested again, because packets arrived since its request. */
  #isStale = true;
  #antialiased: boolean;
  #isClosed = false;

  private constructor(
    private readonly worker: Worker,
    private readonly info: SequenceStreamInfo,
    readonly concealer: string,
  ) {
    super();
    this.#antialiased = info.antialiased;
    this.#clock = info.sequence.live ? new LiveClock(info.sequence.rate) : new ClipClock(info.sequence);
    worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.#onMessage(data));
    worker.addEventListener("error", ({ message }) => {
      this.close();
      this.#fail(message || "the worker failed");
    });
    if (info.sequence.live) this.play();
  }

  /**
   * Starts to receive a clip. Resolves once its properties are known.
   *
   * Rejects if the stream is no clip, if it cannot be received, if `signal` is aborted, or if the policy of the page
   * forbids `worker-src blob:`.
   */
  static async open(url: string | URL, options: ClipOptions = {}): Promise<Clip> {
    const { concealer = "motion", session = null, signal } = options;
    signal?.throwIfAborted();
    const source = await sourceOf(new URL(url, globalThis.location?.href), session);
    signal?.throwIfAborted();
    const worker = startReceiver();
    try {
      worker.postMessage({ kind: "open", ...source, bytes: null } satisfies ToWorker);
      const info = await firstStreamInfo(worker, signal),
        { sequence } = info;
      if (!sequence) throw new Error("the stream is not a clip: load it as a scene");
      if (!info.concealers.includes(concealer))
        throw new Error(`the stream has no concealer '${concealer}', only ${info.concealers.join(", ")}`);
      return new Clip(worker, { ...info, sequence }, concealer);
    } catch (error) {
      worker.terminate();
      throw error;
    }
  }

  /** Frames per second. */
  get rate(): number {
    return this.info.sequence.rate;
  }

  /** True for live clips, which have no end and do not seek. */
  get live(): boolean {
    return this.info.sequence.live;
  }

  /** Duration in seconds; infinite for live clips. */
  get duration(): number {
    return this.live ? Infinity : this.info.sequence.numFrames / this.rate;
  }

  /** Size of the scene, world units. It is the unit of length in frames. */
  get size(): number {
    return this.info.size;
  }

  /**
   * True if opacity decreases for Gaussians below the size of a pixel (Mip-Splatting), as opposed to 3DGS. It may
   * change with a frame of a live clip.
   */
  get antialiased(): boolean {
    return this.#antialiased;
  }

  /** Background colour, RGB, each 0 to 1. */
  get background(): readonly [number, number, number] {
    return this.info.background;
  }

  /** Initial view; null if the stream has none. */
  get viewpoint(): Viewpoint | null {
    return this.info.viewpoint;
  }

  get paused(): boolean {
    return this.#paused;
  }

  /** True after the last frame of a clip without `loop`. */
  get ended(): boolean {
    return this.#clock.ended;
  }

  /**
   * Plays from the current time, from the start if the clip has ended, or at the live position. Without effect after
   * `close` and after an error of the worker.
   */
  play(): void {
    if (this.#isClosed) return;
    const now = performance.now() / 1000;
    this.#due(now); // it may have ended since the last picture
    if (this.ended && !this.live) this.#clock.seek(0);
    this.#paused = false;
    this.#clock.play(now);
    this.#checks ??= setInterval(() => this.#due(performance.now() / 1000), CHECK_MS);
  }

  pause(): void {
    const now = performance.now() / 1000;
    this.#due(now); // brings the time into the present lap
    this.#stop();
    this.#clock.pause(now);
  }

  /** Time of the due frame, seconds. Setting it seeks; live clips ignore this. */
  get currentTime(): number {
    return Math.max(this.#clock.due(performance.now() / 1000, this.loop) ?? 0, 0) / this.rate;
  }

  /** Throws `TypeError` for NaN, as media elements do. */
  set currentTime(seconds: number) {
    if (Number.isNaN(seconds)) throw new TypeError("the time of a clip is a number");
    this.#clock.seek(seconds);
    if (!this.#paused) this.#clock.play(performance.now() / 1000);
  }

  /**
   * Requests the frame that is due. Returns the newest frame that arrived since the last call, or null; it may be an
   * earlier one than the due frame. Call this once per picture. Late frames are skipped.
   */
  update(): ClipFrame | null {
    const due = this.#due(performance.now() / 1000);
    if (due !== null && this.#requested < 0 && (due !== this.#received || this.#isStale)) this.#request(due);
    const arrived = this.#arrived;
    this.#arrived = null;
    return arrived;
  }

  /** Ends the transfer and the worker. No event follows. */
  close(): void {
    this.#isClosed = true;
    this.#paused = true; // before the pause, which would send `ended` after the last frame
    this.pause();
    this.worker.terminate();
  }

  /** Returns the due frame. Pauses after the last one. */
  #due(now: number): number | null {
    const due = this.#clock.due(now, this.loop);
    if (!this.#paused && this.ended) {
      this.#stop();
      this.dispatchEvent(new CustomEvent("ended"));
    }
    return due;
  }

  #stop(): void {
    this.#paused = true;
    clearInterval(this.#checks);
    this.#checks = undefined;
  }

  #request(number: number): void {
    const simulation = { concealer: this.concealer, lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };
    this.#requested = number;
    this.#isStale = false;
    this.worker.postMessage({ kind: "frame", number, simulation } satisfies ToWorker);
  }

  #fail(reason: string): void {
    this.dispatchEvent(new CustomEvent("error", { detail: reason }));
  }

  #onMessage(message: FromWorker): void {
    switch (message.kind) {
      case "frame":
        this.#requested = -1;
        this.#received = message.number;
        if (!message.packed.count) return;
        this.#clock.start(performance.now() / 1000);
        this.#antialiased = message.antialiased;
        this.#arrived = { number: message.number, packed: message.packed };
        return;
      case "playable":
        return this.#clock.playable(message.begin, message.end, performance.now() / 1000);
      case "counts":
        this.#isStale = !this.live;
        return;
      case "finished":
        this.#isStale = !this.live;
        return this.#clock.end();
      case "disconnect":
        this.dispatchEvent(new CustomEvent("lost", { detail: message.reason }));
        return;
      case "failed":
        return this.#fail(message.text);
      case "info": // of another stream: frames have another size and rate
        this.close();
        return this.#fail("the file was replaced: open it again");
    }
  }
}

/** Resolves with the properties of a stream. Rejects if it cannot be received, or when `given` is aborted. */
function firstStreamInfo(worker: Worker, given?: AbortSignal): Promise<StreamInfo> {
  const done = new AbortController(),
    { signal } = done;
  return new Promise<StreamInfo>((resolve, reject) => {
    given?.addEventListener("abort", () => reject(given.reason), { signal });
    const listen = ({ data }: MessageEvent<FromWorker>): void => {
      if (data.kind === "info") resolve(data.info);
      else if (data.kind === "failed") reject(new Error(data.text));
    };
    worker.addEventListener("message", listen, { signal });
    worker.addEventListener("error", ({ message }) => reject(new Error(message || notStarted)), {
      signal,
    });
  }).finally(() => done.abort());
}
