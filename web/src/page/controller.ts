// What an element does with a stream, from its first packet until it is released: the worker receives, the stage draws,
// the panel tells.

import startReceiver from "worker:receiver";

import { readPreview } from "../codec/preview.ts";
import type { FixedCamera } from "../model/camera.ts";
import { pack } from "../render/packed.ts";
import type { View } from "../render/view.ts";
import { Watch } from "../render/watch.ts";
import type { Choice } from "../transport/losses.ts";
import type { Facts, FromWorker, ToWorker } from "../transport/messages.ts";
import { pause } from "../turns.ts";
import { resolveSource, titleOf } from "./address.ts";
import { Comparison } from "./difference.ts";
import { newStatus, type Status, type Tell } from "./events.ts";
import { tellCounts } from "./figures.ts";
import { embedCode, readLink, viewpointOf, writeLink } from "./links.ts";
import { Moments } from "./moments.ts";
import { Motion } from "./motion.ts";
import { Outcome } from "./outcome.ts";
import { Panel } from "./panel.ts";
import { type Shown, Stage } from "./stage.ts";
import { stillPicture } from "./still.ts";

const AGAIN_MS = 400;

export class Controller {
  readonly status: Status = newStatus();
  readonly stage: Stage;
  readonly panel: Panel;
  readonly #motion = new Motion(
    () => this.panel,
    (number) => this.#send({ kind: "frame", number, choice: this.#choice }),
  );
  readonly #moments: Moments;
  readonly #outcome: Outcome;
  readonly #worker: Worker;
  readonly #comparison: Comparison;
  /** Ends what this listens to. */
  readonly #over = new AbortController();
  /** Elements of the whole scene. */
  #gaussians = 0;
  #size = 1;
  /** Redundant Gaussians among those that are drawn. */
  #copies = 0;
  /** Whether Gaussians of the scene, not of a preview, are there. */
  #begun = false;
  #watch: Watch | null = null;
  #asked = 0;
  #gained = 0;
  #timer = 0;

  constructor(
    readonly host: HTMLElement,
    root: ShadowRoot,
    readonly tell: Tell,
  ) {
    this.#worker = startReceiver(); // first of all: a thread takes a while to begin
    this.#worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.#heard(data));
    const fail = (error: Error): void => this.#outcome.fail(error.message);
    this.#worker.addEventListener("error", ({ message }) =>
      fail(new Error(message || "the worker could not be started")),
    );
    const title = titleOf(host);
    this.stage = new Stage(() => this.#conceal(), fail, title);
    const link = (): string => writeLink(this.panel.settings, this.stage.orbit.turned),
      src = host.getAttribute("src"),
      embed = src && embedCode(new URL(src, host.baseURI), import.meta.url),
      copies = { "copy link": link, ...(embed ? { "copy embed code": () => embed } : {}) };
    this.panel = new Panel(
      () => this.#settingsChanged(),
      () => this.#flip(),
      copies,
      title,
      host.ownerDocument.fullscreenEnabled ? () => this.#fullScreen() : null,
    );
    this.#outcome = new Outcome(this.status, this.panel, tell);
    this.#moments = new Moments(this.status, tell, this.#over.signal);
    this.#comparison = new Comparison(
      this.stage,
      () => this.panel.settings.show,
      (psnr) => this.panel.tell("PSNR", psnr === null ? this.#without() : psnr),
    );
    const whole = document.createElement("div");
    whole.className = "whole";
    whole.append(this.stage.surface, this.#comparison.canvas, this.panel.element);
    root.replaceChildren(whole);
    // First of all packets come, in a thread of their own: making ready to draw takes longer than the first of them.
    this.#open().catch(fail);
    this.#begin();
    void this.stage.open();
  }

  /** Gives everything back. */
  destroy(): void {
    this.#over.abort();
    this.#motion.destroy();
    this.#worker.terminate();
    clearTimeout(this.#timer);
    this.panel.destroy();
    this.#comparison.destroy();
    this.stage.destroy();
  }

  /** An attribute changed that concerns what is there. */
  follow(name: string): void {
    const value = this.host.getAttribute(name);
    if (name === "panel") {
      this.panel.element.hidden = value === "none";
      this.panel.open = value === "open";
    }
    if (name === "concealer") this.panel.offer(this.panel.concealers, value);
    if (name === "gestures") this.stage.cooperate(value === "cooperative" && !this.#fillsScreen);
    if (name === "up") this.stage.upIs(value ?? "");
    if (name === "viewpoint") this.#viewpoint(true);
    this.stage.touch();
  }

  verify(): Promise<boolean> {
    return this.#outcome.verify(() => this.#send({ kind: "digest" }));
  }

  async picture(camera: FixedCamera): Promise<string> {
    const view = await new Promise<View>((resolve) => this.stage.draw(resolve));
    const { clientWidth, clientHeight } = this.host,
      width = Math.round((camera.height * clientWidth) / Math.max(clientHeight, 1));
    view.fix({ width, ...camera });
    await view.frame();
    while (this.#gained !== this.#asked || this.#watch?.settled === false) await pause(50);
    return this.#comparison.alone(() => stillPicture(view));
  }

  #begin(): void {
    const { host, stage } = this,
      { signal } = this.#over,
      preview = host.getAttribute("preview"),
      concealer = host.getAttribute("concealer"),
      link = readLink();
    this.follow("panel");
    stage.upIs(host.getAttribute("up") ?? "");
    stage.orbit.turned = link.turned;
    this.panel.set({ ...(concealer ? { concealer } : {}), ...link.settings });
    this.follow("gestures");
    this.#viewpoint(false);
    if (preview)
      this.#preview(() => {
        const { splats, background } = readPreview(Uint8Array.from(atob(preview), (c) => c.charCodeAt(0)));
        return { packed: pack([splats], 0, 1), background };
      });
    const sizes = new ResizeObserver(() => stage.resize()),
      sight = new IntersectionObserver((entries) => {
        stage.sight(entries[entries.length - 1].isIntersecting);
        this.#motion.sight(stage.inSight);
      });
    this.#followDensity();
    sizes.observe(stage.surface);
    sight.observe(host);
    signal.addEventListener("abort", () => {
      sizes.disconnect();
      sight.disconnect();
    });
    host.addEventListener("keydown", (event) => this.#key(event), { signal });
    host.addEventListener("fullscreenchange", () => this.follow("gestures"), { signal });
    stage.surface.addEventListener("pointermove", () => this.#comparison.moved());
    stage.surface.addEventListener("wheel", () => this.#comparison.moved(), { passive: true });
  }

  /** Draws as many pixels as the screen has where its density changes: another screen, or zoom. */
  #followDensity(): void {
    const window = this.host.ownerDocument.defaultView,
      density = window?.matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
    const changed = (): void => {
      this.stage.resize();
      this.#followDensity();
    };
    density?.addEventListener("change", changed, { once: true, signal: this.#over.signal });
  }

  /** Begins where the page says; `anew` wherever somebody has moved to. */
  #viewpoint(anew: boolean): void {
    const viewpoint = viewpointOf(this.host.getAttribute("viewpoint"));
    if (!viewpoint) return;
    if (anew) this.stage.orbit.placed = this.stage.orbit.touched = false;
    this.stage.start(viewpoint);
  }

  async #open(): Promise<void> {
    const { host } = this,
      inside = host.ownerDocument.getElementById(host.getAttribute("data") ?? "");
    this.panel.say("Connecting ...");
    if (inside) {
      const bytes = Uint8Array.from(atob(inside.textContent!.trim()), (c) => c.charCodeAt(0));
      return this.#send({ kind: "open", session: null, name: "", file: "", bytes });
    }
    const src = host.getAttribute("src");
    if (!src) throw new Error("<splat-wire> has no src");
    const source = await resolveSource(
      new URL(src, host.baseURI),
      host.getAttribute("session"),
      host.getAttribute("fingerprint"),
    );
    this.#send({ kind: "open", ...source, bytes: null });
  }

  #heard(message: FromWorker): void {
    const { panel } = this;
    switch (message.kind) {
      case "preview":
        if (!this.#gaussians) this.#preview(() => message);
        return;
      case "facts":
        return this.#learn(message.facts);
      case "splats":
        return this.#add(message);
      case "tiles":
        return this.#recut(message);
      case "frame":
        return this.#frame(message);
      case "playable":
        return this.#motion.playable(message);
      case "counts":
        return this.#count(message);
      case "gains":
        if (message.ask !== this.#asked) return;
        this.#gained = message.ask;
        panel.tell("dropped on purpose", `${this.status.packets - message.shownPackets} packets`);
        return this.#comparison.show(message.gains, message.lossless);
      case "note":
        return panel.say(message.text);
      case "lost":
        return this.#outcome.lost(message.reason, message.retryMs);
      case "finished":
        return this.#finished(message.text, message.complete);
      case "failed":
        return this.#outcome.fail(message.text);
      case "digest":
        return this.#outcome.verified(message.same);
    }
  }

  #finished(text: string, complete: boolean): void {
    this.stage.settle();
    if (this.stage.view) this.#conceal();
    this.#motion.end();
    this.#outcome.finished(text, complete, this.#motion.live);
  }

  /** What there is to see until the scene comes; one that is no preview is nothing to fail for. */
  #preview(read: () => Shown): void {
    try {
      this.stage.preview(read()).then(() => this.#moments.seen("preview"));
      this.panel.say("A preview; the scene is on its way.");
    } catch (error) {
      this.panel.say((error as Error).message);
    }
  }

  #learn(facts: Facts): void {
    const { gaussians, size, middle, viewpoint, extent, up, viewDependent, concealers, moving } = facts,
      { stage } = this;
    this.#motion.begin(moving, stage.inSight);
    this.panel.offer(concealers);
    this.#gaussians = gaussians;
    this.#size = size;
    this.#begun = false;
    this.#copies = 0;
    stage.background(facts.background);
    stage.antialias(facts.antialiased);
    if (up && !this.host.hasAttribute("up")) stage.upIs(up);
    if (viewpoint) stage.start(viewpoint);
    if (middle) stage.face(middle, size);
    stage.extent = extent;
    this.#watch = null;
    stage.watcher = null;
    if (!viewDependent) return;
    const watch = new Watch(size, (camera, ask) => this.#send({ kind: "look", camera, ask }));
    this.#watch = watch;
    stage.watcher = (camera) => watch.see(camera);
    stage.watch();
  }

  #add({ packed, instead, fresh, elements, copies, gains, lossless, ask }: FromWorker & { kind: "splats" }): void {
    this.#start();
    this.#copies = copies;
    this.stage.add(packed, instead);
    this.#watch?.answered(ask);
    if (gains) this.#comparison.show(gains, lossless);
    this.#grown(elements, fresh);
  }

  /** Tiles take the place of others. */
  #recut({ gone, come, fresh, ask }: FromWorker & { kind: "tiles" }): void {
    this.#start();
    if (gone.length || come.length) this.stage.recut(gone, come);
    this.#watch?.answered(ask);
    this.#grown(this.stage.count, fresh);
  }

  /** A frame is there: the next one is asked for when it is on the screen. */
  #frame(message: FromWorker & { kind: "frame" }): void {
    const { number, packed } = message,
      { stage } = this;
    if (packed.count) {
      this.#start();
      stage.add(packed, true);
    }
    this.#motion.tell(message);
    this.#grown(packed.count ? this.#gaussians : 0, false);
    const done = (): void => this.#motion.shown(number);
    if (stage.view) void stage.view.steady().then(done);
    else setTimeout(done);
  }

  /** Gaussians of the scene come: a preview goes. */
  #start(): void {
    if (!this.#begun) this.stage.begin(this.#size);
    this.#begun = true;
  }

  /** There are Gaussians of so many elements now; of `fresh` ones nobody has told which are concealed. */
  #grown(elements: number, fresh: boolean): void {
    const { stage } = this;
    this.status.gaussians = stage.count - this.#copies;
    this.panel.tell("Gaussians", this.status.gaussians.toLocaleString());
    const shown = (): Promise<void> => stage.shown();
    if (elements || !this.#gaussians) this.#moments.soon("first", shown);
    if (elements >= this.#gaussians / 2) {
      this.#moments.soon("half", shown);
      stage.enough();
    }
    if (fresh && stage.view) this.#concealSoon();
  }

  #count(message: FromWorker & { kind: "counts" }): void {
    const { packets, expected, bytes, way } = message.counts;
    Object.assign(this.status, { packets, expected, way, decodeMs: message.decodeMs });
    tellCounts(this.panel, message);
    this.#outcome.progress(this.#motion.live);
    this.tell("progress", { packets, expected, bytes, gaussians: this.status.gaussians });
  }

  /** What the PSNR is of where nothing was dropped on purpose. */
  #without(): string {
    return this.status.complete ? "no loss" : "of what arrived: nothing dropped";
  }

  #settingsChanged(): void {
    if (this.#motion.any) return this.#motion.again();
    if (this.stage.view) this.#conceal(); // what is painted before has no gains
  }

  /** Asks for new gains, not too often while packets come. */
  #concealSoon(): void {
    this.#timer ||= window.setTimeout(() => this.#conceal(), AGAIN_MS);
  }

  #conceal(): void {
    if (this.#motion.any) return this.#motion.again();
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#send({ kind: "conceal", choice: this.#choice, ask: ++this.#asked });
  }

  /** What is dropped on purpose, and how that is concealed. */
  get #choice(): Choice {
    const { show: _, ...choice } = this.panel.settings;
    return choice;
  }

  #flip(): void {
    this.stage.orbit.flip();
    this.#comparison.moved();
  }

  /** True if this element fills the screen, not one around it. */
  get #fillsScreen(): boolean {
    return (this.host.getRootNode() as Document | ShadowRoot).fullscreenElement === this.host;
  }

  #fullScreen(): void {
    const done = this.#fillsScreen ? this.host.ownerDocument.exitFullscreen() : this.host.requestFullscreen();
    done.catch((error: Error) => this.panel.say(`The screen cannot be filled: ${error.message}`));
  }

  #key(event: KeyboardEvent): void {
    const origin = event.composedPath()[0];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (origin instanceof HTMLInputElement || origin instanceof HTMLSelectElement) return;
    if (event.key === "f") this.#flip();
    else if (event.key === "h") this.panel.element.hidden = !this.panel.element.hidden;
    else if (!this.stage.hands.key(event.key, event.shiftKey)) return;
    this.#comparison.moved();
    event.preventDefault();
  }

  #send(message: ToWorker): void {
    this.#worker.postMessage(message);
  }
}
