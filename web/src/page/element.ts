// <splat-wire src="https://host/streams/scene.swz">: a stream, received and drawn.

import SOURCE from "worker:receiver";

import { readPreview } from "../codec/preview.ts";
import { pack } from "../render/packed.ts";
import type { FixedCamera, View } from "../render/view.ts";
import { Watch } from "../render/watch.ts";
import type { Facts, FromWorker, ToWorker } from "../transport/messages.ts";
import { resolveSource } from "./address.ts";
import { Comparison } from "./difference.ts";
import { embedCode, readLink, viewpointOf, writeLink } from "./links.ts";
import { Panel } from "./panel.ts";
import { type Shown, Stage } from "./stage.ts";
import { STYLE } from "./style.ts";

const AGAIN_MS = 400;

/** What tests and other pages read. */
export interface Status {
  finished: string | null;
  failed: string | null;
  complete: boolean;
  gaussians: number;
  packets: number;
  way: string;
  /** Time that the worker spent on decoding. */
  decodeMs: number;
  /** Milliseconds since navigation: preview, first Gaussians and half of them on the screen. */
  times: Record<string, number>;
}

export class SplatWire extends HTMLElement {
  readonly status: Status = {
    finished: null,
    failed: null,
    complete: false,
    gaussians: 0,
    packets: 0,
    way: "",
    decodeMs: 0,
    times: {},
  };
  #worker: Worker | null = null;
  readonly #stage = new Stage();
  #panel!: Panel;
  #comparison!: Comparison;
  /** Elements of the whole scene. */
  #gaussians = 0;
  #size = 1;
  #watch: Watch | null = null;
  #asked = 0;
  #gained = 0;
  #timer = 0;
  #digest: ((same: boolean) => void) | null = null;

  connectedCallback(): void {
    if (this.shadowRoot) return;
    this.#start(); // first of all: a thread takes a while to begin
    const root = this.attachShadow({ mode: "open" }),
      style = new CSSStyleSheet();
    style.replaceSync(STYLE);
    root.adoptedStyleSheets = [style];
    const link = (): string => writeLink(this.#panel.settings, this.#stage.orbit.turned),
      src = this.getAttribute("src");
    const copies = { "copy link": link, ...(src ? { "copy embed code": () => embedCode(src) } : {}) };
    this.#panel = new Panel(
      () => this.#settingsChanged(),
      () => this.#flip(),
      copies,
    );
    this.#comparison = new Comparison(
      this.#stage,
      () => this.#panel.settings.show,
      (psnr) => this.#panel.tell("PSNR", psnr),
    );
    root.append(this.#stage.canvas, this.#stage.first, this.#comparison.canvas, this.#panel.element);
    if (this.getAttribute("panel") === "none") this.#panel.element.hidden = true;
    this.#panel.element.open = this.clientWidth > 560;
    const fail = (error: unknown): void => this.#fail((error as Error).message);
    // First of all packets come, in a thread of their own: making ready to draw takes longer than the first of them.
    this.#open().catch(fail);
    this.#begin();
    this.#stage.open().then(() => this.#conceal(), fail);
  }

  disconnectedCallback(): void {
    this.#worker?.terminate();
  }

  get view(): View | null {
    return this.#stage.view;
  }

  get panel(): Panel {
    return this.#panel;
  }

  /** Whether all integers that were decoded are those that were encoded. */
  verify(): Promise<boolean> {
    this.#send({ kind: "digest" });
    return new Promise((resolve) => (this.#digest = resolve));
  }

  /** A PNG of the scene as a camera of splatwire sees it, in the camera's size. */
  async picture(camera: FixedCamera): Promise<string> {
    const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));
    const view = await new Promise<View>((resolve) => this.#stage.draw(resolve));
    view.fix(camera);
    await view.frame();
    while (this.#gained !== this.#asked || this.#watch?.settled === false) await pause(50);
    return this.#comparison.alone(async () => {
      await view.frame();
      await view.sorted();
      // A sort that was under way is followed by that of what changed meanwhile: until nothing changes any more.
      // Sorts take the longer the busier the machine is, as frames do.
      let before = "",
        now = view.canvas.toDataURL("image/png"),
        wait = 400;
      for (let n = 0; n < 20 && now !== before; n++) {
        await pause(wait);
        const began = performance.now();
        await view.frame();
        wait = Math.max(400, 8 * (performance.now() - began));
        [before, now] = [now, view.canvas.toDataURL("image/png")];
      }
      return now;
    });
  }

  #begin(): void {
    const { canvas, orbit } = this.#stage,
      preview = this.getAttribute("preview"),
      link = readLink(),
      begin = this.getAttribute("viewpoint")?.split(" ").map(Number);
    if (this.getAttribute("up") === "y") orbit.yUp();
    orbit.turned = link.turned;
    this.#panel.set(link.settings);
    if (begin?.length === 9) this.#stage.start(viewpointOf(begin));
    if (preview)
      this.#preview(() => {
        const { splats, background } = readPreview(Uint8Array.from(atob(preview), (c) => c.charCodeAt(0)));
        return { packed: pack([splats], 0, 1), background };
      });
    new ResizeObserver(() => this.#stage.resize()).observe(this);
    canvas.addEventListener("webglcontextlost", () =>
      this.#fail("The browser took the graphics card away; load the page again."),
    );
    this.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("pointermove", () => this.#comparison.moved());
    canvas.addEventListener("wheel", () => this.#comparison.moved(), { passive: true });
  }

  #start(): void {
    this.#worker = new Worker(URL.createObjectURL(new Blob([SOURCE], { type: "text/javascript" })));
    this.#worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.#heard(data));
    this.#worker.addEventListener("error", (event) => this.#fail(event.message || "the worker could not be started"));
  }

  async #open(): Promise<void> {
    const inside = document.getElementById(this.getAttribute("data") ?? "");
    this.#panel.say("Connecting ...");
    if (inside) {
      const bytes = Uint8Array.from(atob(inside.textContent!.trim()), (c) => c.charCodeAt(0));
      return this.#send({ kind: "open", session: null, name: "", file: "", bytes });
    }
    const src = this.getAttribute("src");
    if (!src) throw new Error("<splat-wire> has no src");
    const source = await resolveSource(src, this.getAttribute("session"), this.getAttribute("fingerprint"));
    this.#send({ kind: "open", ...source, bytes: null });
  }

  #heard(message: FromWorker): void {
    const panel = this.#panel;
    switch (message.kind) {
      case "preview":
        if (!this.#gaussians) this.#preview(() => message);
        return;
      case "facts":
        return this.#learn(message.facts);
      case "splats":
        return this.#add(message);
      case "counts":
        return this.#count(message);
      case "gains":
        if (message.ask !== this.#asked) return;
        this.#gained = message.ask;
        panel.tell("dropped on purpose", `${this.status.packets - message.shownPackets} packets`);
        return this.#comparison.show(message.gains);
      case "note":
        return panel.say(message.text);
      case "finished":
        this.status.finished = message.text;
        this.status.complete = message.complete;
        if (this.#stage.view) this.#conceal();
        return panel.say(
          message.complete ? "Everything is there." : `It ended early: ${message.text}. What is missing is concealed.`,
        );
      case "failed":
        return this.#fail(message.text);
      case "digest":
        this.#digest?.(message.found === message.expected);
    }
  }

  /** What there is to see until the scene comes; one that is no preview is nothing to fail for. */
  #preview(read: () => Shown): void {
    try {
      this.#stage.preview(read()).then(() => (this.status.times["preview"] ??= performance.now()));
      this.#panel.say("A preview; the scene is on its way.");
    } catch (error) {
      this.#panel.say((error as Error).message);
    }
  }

  #learn({ gaussians, size, middle, background, viewpoint, viewDependent, concealers }: Facts): void {
    const stage = this.#stage;
    this.#panel.offer(concealers);
    this.#gaussians = gaussians;
    this.#size = size;
    stage.background(background);
    if (viewpoint) stage.start(viewpoint);
    if (middle) stage.face(middle, size);
    if (!viewDependent) return;
    const watch = (this.#watch = new Watch(size, (camera, ask) => this.#send({ kind: "look", camera, ask })));
    stage.watcher = (camera) => watch.see(camera);
    watch.see(stage.camera);
  }

  #add({ packed, instead, fresh, elements, gains, ask }: FromWorker & { kind: "splats" }): void {
    const stage = this.#stage;
    if (this.status.gaussians === 0) stage.begin(this.#size);
    stage.add(packed, instead);
    this.#watch?.answered(ask);
    if (gains) this.#comparison.show(gains);
    this.status.gaussians = stage.count;
    this.panel.tell("Gaussians", stage.count.toLocaleString());
    this.#time("first");
    if (elements >= this.#gaussians / 2) {
      this.#time("half");
      stage.enough();
    }
    if (fresh && stage.view) this.#concealSoon();
  }

  #count({ counts, decodeMs, corrupt }: FromWorker & { kind: "counts" }): void {
    const { panel, status } = this,
      share = counts.expected ? counts.packets / counts.expected : 0;
    status.packets = counts.packets;
    status.way = counts.way;
    status.decodeMs = decodeMs;
    panel.progress(share);
    const damaged = corrupt ? `, ${corrupt} damaged` : "";
    panel.tell("packets", `${counts.packets.toLocaleString()} of ${counts.expected.toLocaleString()}${damaged}`);
    panel.tell("received", `${(counts.bytes / 1e6).toFixed(2)} MB`);
    panel.tell("rate", counts.seconds > 0 ? `${((counts.bytes * 8) / 1e6 / counts.seconds).toFixed(1)} Mbit/s` : "-");
    panel.tell("lost on the way", counts.lost ? `${counts.lost} datagrams` : "none");
    panel.tell("time", `${counts.seconds.toFixed(2)} s`);
    panel.tell("decoding", `${(decodeMs / 1000).toFixed(2)} s`);
    panel.tell("way", counts.way);
    if (share > 0 && !status.finished) panel.say("Receiving ...");
  }

  #fail(text: string): void {
    this.status.failed = text;
    this.#panel.say(text, true);
  }

  #settingsChanged(): void {
    if (this.#stage.view) this.#conceal(); // what is painted before has no gains
  }

  /** Asks for new gains, not too often while packets come. */
  #concealSoon(): void {
    this.#timer ||= window.setTimeout(() => this.#conceal(), AGAIN_MS);
  }

  #conceal(): void {
    const { show: _, ...choice } = this.#panel.settings;
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#send({ kind: "conceal", choice, ask: ++this.#asked });
  }

  #flip(): void {
    this.#stage.orbit.flip();
    this.#comparison.moved();
  }

  #key(event: KeyboardEvent): void {
    const origin = event.composedPath()[0];
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      origin instanceof HTMLInputElement ||
      origin instanceof HTMLSelectElement
    )
      return;
    if (event.key === "f") this.#flip();
    else if (event.key === "h") this.#panel.element.hidden = !this.#panel.element.hidden;
    else if (!this.#stage.orbit.key(event.key, event.shiftKey)) return;
    this.#comparison.moved();
    event.preventDefault();
  }

  #time(name: string): void {
    if (name in this.status.times) return;
    this.status.times[name] = NaN;
    this.#stage.shown().then(() => (this.status.times[name] = performance.now()));
  }

  #send(message: ToWorker): void {
    this.#worker?.postMessage(message);
  }
}
