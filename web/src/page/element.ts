// Element <splat-wire src="https://host/streams/scene.swz">, which receives and draws a stream. `controller.ts`
// implements it.

import type { ListenerMethod } from "../listener_method.ts";
import { checkCamera, type FixedCamera } from "../model/camera.ts";
import type { WebGLRenderer } from "../render/webgl_renderer.ts";
import { applyStyles } from "./apply_styles.ts";
import { Base } from "./base.ts";
import { Controller } from "./controller.ts";
import { newStatus, type SplatWireEventMap, type Status } from "./events.ts";
import { viewpointOf } from "./links.ts";
import type { Panel } from "./panel.ts";
import { SequencePlayback, type WantedPlayback } from "./sequence_playback.ts";

/** Attributes that identify the stream. Other attributes are applied without restarting it. */
const SOURCES: readonly string[] = ["src", "session", "fingerprint", "data"];
/** Attributes whose properties have their text, or the empty string. */
const REFLECTED = [
  "src",
  "session",
  "fingerprint",
  "concealer",
  "viewpoint",
  "up",
  "panel",
  "gestures",
  "poster",
  "camera-limits",
] as const;

/** Interfaces of browsers without which the element does not start. Test environments such as jsdom lack some. */
const NEEDED = ["Worker", "ResizeObserver", "IntersectionObserver", "matchMedia"];

export class SplatWire extends Base {
  static readonly observedAttributes = [...REFLECTED, "data", "autorotate", "max-gaussians", "updates"];
  /** URL of the stream. */
  declare src: string;
  /** URL of the WebTransport session. */
  declare session: string;
  /** SHA-256 of the certificate of `session`. */
  declare fingerprint: string;
  /**
   * Concealer: `drop`, `grow`, `scene_free` or `sketch`. The empty string means `sketch` if available, else `grow`. Of
   * a clip: `motion` (the default), `hold` or `drop`.
   */
  declare concealer: string;
  /** Initial view, nine numbers: eye, target, up. */
  declare viewpoint: string;
  /** Axis of the scene that points up: `x`, `y` or `z`, or with `-` the opposite direction. */
  declare up: string;
  /** `none` hides the controls, `open` opens the settings. */
  declare panel: string;
  /** `cooperative` leaves the wheel and one-finger gestures to the page. The empty string lets the scene take them. */
  declare gestures: string;
  /** URL of a picture that is visible until the first Gaussians are. */
  declare poster: string;
  /** Limits of the camera: four numbers, see docs/browser.md. The empty string means none. */
  declare cameraLimits: string;

  declare addEventListener: ListenerMethod<SplatWire, SplatWireEventMap, AddEventListenerOptions>;
  declare removeEventListener: ListenerMethod<SplatWire, SplatWireEventMap, EventListenerOptions>;

  static {
    for (const name of REFLECTED)
      Object.defineProperty(SplatWire.prototype, name.replace("-l", "L"), {
        get(this: SplatWire): string {
          return this.getAttribute(name) ?? "";
        },
        set(this: SplatWire, value: unknown) {
          this.#set(name, value);
        },
        enumerable: true,
        configurable: true,
      });
  }

  #controller: Controller | null = null;
  #status = newStatus();
  #restartPending = false;
  readonly #wanted: WantedPlayback = {};
  /** Playback while no stream is loaded. */
  readonly #unloaded = new SequencePlayback(
    () => this.controlPanel,
    () => undefined,
    this.#wanted,
  );

  connectedCallback(): void {
    // properties that a page set before the element was defined hide those of the class
    for (const [name, value] of Object.entries(this))
      if (name in SplatWire.prototype && Reflect.deleteProperty(this, name)) Reflect.set(this, name, value);
    if (!this.#controller) this.#start();
  }

  /** Applies the styles again, because style sheets belong to one document, and follows its window. */
  adoptedCallback(): void {
    if (this.shadowRoot) applyStyles(this.shadowRoot);
    this.#controller?.onAdopted();
  }

  /** Releases the element, unless it is only moved and therefore connected again within the same task. */
  disconnectedCallback(): void {
    setTimeout(() => {
      if (!this.isConnected) this.#release();
    });
  }

  attributeChangedCallback(name: string, before: string | null, after: string | null): void {
    if (before === after || !this.#controller) return;
    if (!SOURCES.includes(name)) return this.#controller.applyAttribute(name);
    if (this.#restartPending) return;
    this.#restartPending = true;
    queueMicrotask(() => {
      // one restart for all attributes changed in the same task
      this.#restartPending = false;
      if (this.#controller) this.retry();
    });
  }

  #start(): void {
    const root = this.shadowRoot ?? this.attachShadow({ mode: "open" }),
      missing = NEEDED.find((name) => !(name in globalThis));
    if (missing) return this.#fail(root, `this browser has no ${missing}`);
    applyStyles(root);
    this.#controller = new Controller(
      this,
      root,
      (name, detail) => this.dispatchEvent(new CustomEvent(name, { detail })),
      () => this.#release(),
      () => this.retry(),
      this.#wanted,
    );
    this.#status = this.#controller.status;
  }

  /** Reports that the element cannot start. Listeners that the page adds in this task hear it. */
  #fail(root: ShadowRoot, message: string): void {
    root.textContent = message;
    this.#status = { ...newStatus(), failed: message };
    setTimeout(() => this.dispatchEvent(new CustomEvent("error", { detail: { message } })));
  }

  #release(): void {
    this.#controller?.destroy();
    this.#controller = null;
  }

  /** Speed of the automatic rotation in degrees per second; the empty string means 12, null means none. */
  get autorotate(): string | null {
    return this.getAttribute("autorotate");
  }

  set autorotate(value: string | null) {
    this.#set("autorotate", value);
  }

  /** Maximum number of drawn Gaussians of a scene with levels; 0 means that of the device. */
  get maxGaussians(): number {
    return Number(this.getAttribute("max-gaussians"));
  }

  set maxGaussians(value: number) {
    this.#set("max-gaussians", value);
  }

  /** True to request and show updates of the scene, which are files in the folder of the scene's file. */
  get updates(): boolean {
    return (this.getAttribute("updates") ?? "false") !== "false"; // React 18 writes `false` as text
  }

  set updates(value: boolean) {
    this.#set("updates", value || (value as unknown) === ""); // 0 and NaN mean false
  }

  /** Sets an attribute as frameworks set properties: null, undefined and false remove it, true is the empty string. */
  #set(name: string, value: unknown): void {
    const given = value ?? false;
    if (given === false) this.removeAttribute(name);
    else this.setAttribute(name, given === true ? "" : (given as string));
  }

  /** Starts the stream again. */
  retry(): void {
    this.#release();
    if (this.isConnected) this.#start();
  }

  /** Playback of the clip; before there is one, it keeps what is requested. */
  get #playback(): SequencePlayback {
    return (!this.#restartPending && this.#controller?.playback) || this.#unloaded;
  }

  /** Plays a clip. */
  play(): void {
    this.#playback.play(true);
  }

  /** Pauses a clip. */
  pause(): void {
    this.#playback.play(false);
  }

  /** True if no clip plays. */
  get paused(): boolean {
    return this.#playback.paused;
  }

  /** Time of the frame of a clip that was requested last, seconds. Setting it shows that frame and pauses. */
  get currentTime(): number {
    return this.#playback.currentTime;
  }

  set currentTime(seconds: number) {
    this.#playback.seek(Number(seconds));
  }

  /** Duration of a clip, seconds; 0 for a still, infinite for a live clip. */
  get duration(): number {
    return this.#playback.duration;
  }

  /** Returns the current view as a value of the attribute `viewpoint`: eye, target and up direction. */
  saveView(): string {
    const { eye, target, up } = this.#running.viewpoint;
    return [...eye, ...target, ...up].join(" ");
  }

  /**
   * Moves the camera to a viewpoint, nine numbers as those of `saveView`. Resolves to true on arrival, to false if the
   * visitor or another movement stops it.
   */
  async flyTo(viewpoint: string, seconds = 1): Promise<boolean> {
    const target = viewpointOf(viewpoint);
    if (!target) throw new Error(`a viewpoint is nine numbers (eye, target other than eye, up), not ${viewpoint}`);
    return this.#running.stage.fly(target, seconds);
  }

  /** Returns a link to this page with the current view. */
  link(): string {
    return this.#running.link;
  }

  get status(): Readonly<Status> {
    return this.#status;
  }

  /** @internal */
  get view(): WebGLRenderer | null {
    return this.#controller?.stage.renderer ?? null;
  }

  /** @internal Throws if the element is not in a document. */
  get controlPanel(): Panel {
    return this.#running.panel;
  }

  /** Resolves to true if all decoded integers equal the encoded ones. Rejects if the element is removed. */
  async verify(): Promise<boolean> {
    return this.#running.verify();
  }

  /**
   * Resolves to a PNG data URL of the scene as seen by a camera of splatwire, in that camera's size. Rejects if the
   * element is removed.
   */
  async picture(camera: FixedCamera): Promise<string> {
    checkCamera(camera, 1);
    return this.#running.picture(camera);
  }

  get #running(): Controller {
    if (!this.#controller) throw new Error("this <splat-wire> is not in a document");
    return this.#controller;
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "splat-wire": SplatWire;
  }
}
