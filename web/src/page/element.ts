// <splat-wire src="https://host/streams/scene.swz">: a stream, received and drawn. What it does is in `controller.ts`.

import type { FixedCamera } from "../model/camera.ts";
import type { View } from "../render/view.ts";
import { Controller } from "./controller.ts";
import { dress } from "./dress.ts";
import { newStatus, type SplatWireEventMap, type Status } from "./events.ts";
import type { Panel } from "./panel.ts";

/** Attributes that say which stream it is; of the others each is followed at once. */
const SOURCES: readonly string[] = ["src", "session", "fingerprint", "data"];

/** Stands for `HTMLElement` where there is no document: a server that renders pages can import the module. */
const Base: typeof HTMLElement = globalThis.HTMLElement ?? class {};

export class SplatWire extends Base {
  static readonly observedAttributes = [...SOURCES, "concealer", "viewpoint", "up", "panel", "gestures"];
  #controller: Controller | null = null;
  #status = newStatus();
  #stale = false;

  connectedCallback(): void {
    if (!this.#controller) this.#begin();
  }

  /** Style sheets belong to a document: a move to another one takes them away. */
  adoptedCallback(): void {
    if (this.shadowRoot) dress(this.shadowRoot);
  }

  /** An element that is moved is connected again in the same task. */
  disconnectedCallback(): void {
    setTimeout(() => {
      if (!this.isConnected) this.#release();
    });
  }

  attributeChangedCallback(name: string, before: string | null, after: string | null): void {
    if (before === after || !this.#controller) return;
    if (!SOURCES.includes(name)) return this.#controller.follow(name);
    if (this.#stale) return;
    this.#stale = true;
    queueMicrotask(() => {
      // once for all that changed with it
      this.#stale = false;
      if (!this.#controller) return;
      this.#release();
      this.#begin();
    });
  }

  #begin(): void {
    const root = this.shadowRoot ?? this.attachShadow({ mode: "open" });
    dress(root);
    this.#controller = new Controller(this, root, (name, detail) =>
      this.dispatchEvent(new CustomEvent(name, { detail })),
    );
    this.#status = this.#controller.status;
  }

  #release(): void {
    this.#controller?.destroy();
    this.#controller = null;
  }

  /** Address of the stream. */
  get src(): string {
    return this.getAttribute("src") ?? "";
  }

  set src(value: string) {
    this.setAttribute("src", value);
  }

  /** Address of WebTransport sessions. */
  get session(): string {
    return this.getAttribute("session") ?? "";
  }

  set session(value: string) {
    this.setAttribute("session", value);
  }

  /** Hash of the certificate of `session`. */
  get fingerprint(): string {
    return this.getAttribute("fingerprint") ?? "";
  }

  set fingerprint(value: string) {
    this.setAttribute("fingerprint", value);
  }

  /** What hides losses: `drop`, `grow`, `scene_free`, `sketch`; "" for `sketch` if there is one, else `grow`. */
  get concealer(): string {
    return this.getAttribute("concealer") ?? "";
  }

  set concealer(value: string) {
    this.setAttribute("concealer", value);
  }

  /** Where it is looked from first: nine numbers (eye, target, up). */
  get viewpoint(): string {
    return this.getAttribute("viewpoint") ?? "";
  }

  set viewpoint(value: string) {
    this.setAttribute("viewpoint", value);
  }

  /** `cooperative` leaves the wheel and one finger to the page; "" takes them for the scene. */
  get gestures(): string {
    return this.getAttribute("gestures") ?? "";
  }

  set gestures(value: string) {
    this.setAttribute("gestures", value);
  }

  get status(): Readonly<Status> {
    return this.#status;
  }

  /** @internal */
  get view(): View | null {
    return this.#controller?.stage.view ?? null;
  }

  /** @internal Throws where the element is not in a document. */
  get panel(): Panel {
    return this.#running.panel;
  }

  /** Whether all integers that were decoded are those that were encoded. */
  verify(): Promise<boolean> {
    return this.#running.verify();
  }

  /** A PNG of the scene as a camera of splatwire sees it, in the camera's size. */
  picture(camera: FixedCamera): Promise<string> {
    return this.#running.picture(camera);
  }

  get #running(): Controller {
    if (!this.#controller) throw new Error("this <splat-wire> is not in a document");
    return this.#controller;
  }

  override addEventListener<Name extends keyof SplatWireEventMap>(
    type: Name,
    listener: (this: SplatWire, event: SplatWireEventMap[Name]) => unknown,
    options?: boolean | AddEventListenerOptions,
  ): void;
  override addEventListener(
    type: string,
    listener: EventListenerOrEventListenerObject | null,
    options?: boolean | AddEventListenerOptions,
  ): void;
  override addEventListener(type: string, listener: unknown, options?: boolean | AddEventListenerOptions): void {
    super.addEventListener(type, listener as EventListener, options);
  }

  override removeEventListener<Name extends keyof SplatWireEventMap>(
    type: Name,
    listener: (this: SplatWire, event: SplatWireEventMap[Name]) => unknown,
    options?: boolean | EventListenerOptions,
  ): void;
  override removeEventListener(
    type: string,
    listener: EventListenerOrEventListenerObject | null,
    options?: boolean | EventListenerOptions,
  ): void;
  override removeEventListener(type: string, listener: unknown, options?: boolean | EventListenerOptions): void {
    super.removeEventListener(type, listener as EventListener, options);
  }
}

declare global {
  interface HTMLElementTagNameMap {
    "splat-wire": SplatWire;
  }
}
