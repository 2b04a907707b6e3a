// What an element does with a stream, from its first packet until it is released: the worker receives, the stage draws,
// the panel tells.

import startReceiver from "worker:receiver";

import { readPreview } from "../codec/preview.ts";
import type { FixedCamera } from "../model/camera.ts";
import { pack } from "../render/packed.ts";
import type { View } from "../render/view.ts";
import { Watch } from "../render/watch.ts";
import type { Facts, FromWorker, ToWorker } from "../transport/messages.ts";
import { resolveSource, titleOf } from "./address.ts";
import { Comparison } from "./difference.ts";
import { newStatus, type Status, type Tell } from "./events.ts";
import { embedCode, readLink, viewpointOf, writeLink } from "./links.ts";
import { LivePlayer } from "./live_player.ts";
import { Panel } from "./panel.ts";
import { Player } from "./player.ts";
import { type Shown, Stage } from "./stage.ts";

const AGAIN_MS = 400;

export class Controller {
  readonly status: Status = newStatus();
  readonly stage: Stage;
  readonly panel: Panel;
  readonly #worker: Worker;
  readonly #comparison: Comparison;
  /** Ends what this listens to. */
  readonly #over = new AbortController();
  /** Elements of the whole scene. */
  #gaussians = 0;
  #size = 1;
  /** Whether Gaussians of the scene, not of a preview, are there. */
  #begun = false;
  #watch: Watch | null = null;
  /** Of what moves. */
  #player: Player | LivePlayer | null = null;
  #asked = 0;
  #drops = 0;
  #gained = 0;
  #timer = 0;
  #digests: ((same: boolean) => void)[] = [];

  constructor(
    readonly host: HTMLElement,
    root: ShadowRoot,
    readonly tell: Tell,
  ) {
    this.#worker = startReceiver(); // first of all: a thread takes a while to begin
    this.#worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.#heard(data));
    this.#worker.addEventListener("error", (event) => this.#fail(event.message || "the worker could not be started"));
    const fail = (error: Error): void => this.#fail(error.message);
    const title = titleOf(host);
    this.stage = new Stage(() => this.#conceal(), fail, title);
    const link = (): string => writeLink(this.panel.settings, this.stage.orbit.turned),
      src = host.getAttribute("src"),
      copies = { "copy link": link, ...(src ? { "copy embed code": () => embedCode(src) } : {}) };
    this.panel = new Panel(
      () => this.#settingsChanged(),
      () => this.#flip(),
      copies,
      title,
      document.fullscreenEnabled ? () => this.#fullScreen() : null,
    );
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
    this.#player?.destroy();
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
    if (name === "up") this.stage.upIs(value ?? "");
    if (name === "viewpoint") this.#viewpoint(true);
    this.stage.touch();
  }

  verify(): Promise<boolean> {
    if (this.status.verified !== null) return Promise.resolve(this.status.verified);
    this.#send({ kind: "digest" });
    return new Promise((resolve) => this.#digests.push(resolve));
  }

  async picture(camera: FixedCamera): Promise<string> {
    const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));
    const view = await new Promise<View>((resolve) => this.stage.draw(resolve));
    const { clientWidth, clientHeight } = this.host,
      width = Math.round((camera.height * clientWidth) / Math.max(clientHeight, 1));
    view.fix({ width, ...camera });
    await view.frame();
    while (this.#gained !== this.#asked || this.#watch?.settled === false) await pause(50);
    return this.#comparison.alone(async () => {
      await view.steady();
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
    const { host, stage } = this,
      { signal } = this.#over,
      preview = host.getAttribute("preview"),
      concealer = host.getAttribute("concealer"),
      link = readLink();
    this.follow("panel");
    stage.upIs(host.getAttribute("up") ?? "");
    stage.orbit.turned = link.turned;
    this.panel.set({ ...(concealer ? { concealer } : {}), ...link.settings });
    this.#viewpoint(false);
    if (preview)
      this.#preview(() => {
        const { splats, background } = readPreview(Uint8Array.from(atob(preview), (c) => c.charCodeAt(0)));
        return { packed: pack([splats], 0, 1), background };
      });
    const sizes = new ResizeObserver(() => stage.resize()),
      sight = new IntersectionObserver((entries) => {
        stage.sight(entries[entries.length - 1].isIntersecting);
        this.#player?.sight(stage.inSight);
      });
    sizes.observe(stage.surface);
    sight.observe(host);
    signal.addEventListener("abort", () => {
      sizes.disconnect();
      sight.disconnect();
    });
    host.addEventListener("keydown", (event) => this.#key(event), { signal });
    stage.surface.addEventListener("pointermove", () => this.#comparison.moved());
    stage.surface.addEventListener("wheel", () => this.#comparison.moved(), { passive: true });
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
      inside = document.getElementById(host.getAttribute("data") ?? "");
    this.panel.say("Connecting ...");
    if (inside) {
      const bytes = Uint8Array.from(atob(inside.textContent!.trim()), (c) => c.charCodeAt(0));
      return this.#send({ kind: "open", session: null, name: "", file: "", bytes });
    }
    const src = host.getAttribute("src");
    if (!src) throw new Error("<splat-wire> has no src");
    const source = await resolveSource(src, host.getAttribute("session"), host.getAttribute("fingerprint"));
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
        return this.#playable(message);
      case "counts":
        return this.#count(message);
      case "gains":
        if (message.ask !== this.#asked) return;
        this.#gained = message.ask;
        panel.tell("dropped on purpose", `${this.status.packets - message.shownPackets} packets`);
        return this.#comparison.show(message.gains);
      case "note":
        return panel.say(message.text);
      case "lost":
        return this.#lost(message.reason, message.retryMs);
      case "finished":
        return this.#finished(message.text, message.complete);
      case "failed":
        return this.#fail(message.text);
      case "digest":
        return this.#verified(message.same);
    }
  }

  #finished(text: string, complete: boolean): void {
    const { status, panel } = this;
    status.finished = text;
    status.complete = complete;
    status.lost = null;
    this.stage.settle();
    if (this.stage.view) this.#conceal();
    if (status.failed) return;
    if (this.#player instanceof LivePlayer) {
      this.#player.end();
      panel.say(text === "complete" || text === "sent" ? "The live clip has ended." : `The live clip ended: ${text}.`);
      return this.tell("load", { complete, verified: false });
    }
    if (complete) return panel.say("Everything came; it is being checked.");
    panel.say(`It ended early: ${text}. What is missing is concealed.`);
    this.tell("load", { complete, verified: false });
  }

  #verified(same: boolean): void {
    const { status } = this;
    for (const resolve of this.#digests.splice(0)) resolve(same);
    if (!status.complete || status.verified !== null) return;
    status.verified = same;
    if (!same) this.#fail("Everything came, and it is not what was encoded: the stream was altered or is damaged.");
    else if (!status.failed) this.panel.say("Everything is there.", "done");
    this.tell("load", { complete: true, verified: same });
  }

  #lost(reason: string, retryMs: number): void {
    this.status.lost = reason;
    this.panel.tell("link", `dropped ${++this.#drops === 1 ? "once" : `${this.#drops} times`}: ${reason}`);
    this.panel.say(`The link dropped (${reason}); trying again in ${Math.round(retryMs / 1000) || 1} s.`, "bad");
    this.tell("lost", { reason, retryMs });
  }

  /** What there is to see until the scene comes; one that is no preview is nothing to fail for. */
  #preview(read: () => Shown): void {
    try {
      this.stage.preview(read()).then(() => this.#seen("preview"));
      this.panel.say("A preview; the scene is on its way.");
    } catch (error) {
      this.panel.say((error as Error).message);
    }
  }

  #learn(facts: Facts): void {
    const { gaussians, size, middle, viewpoint, extent, up, viewDependent, concealers, moving } = facts,
      { stage } = this;
    this.#player?.destroy();
    const ask = (number: number): void => this.#askFrame(number);
    this.#player = moving && (moving.live ? new LivePlayer(moving.rate, ask) : new Player(moving, ask));
    if (this.#player) this.panel.add(this.#player.element);
    this.#player?.sight(stage.inSight);
    this.panel.offer(concealers);
    this.#gaussians = gaussians;
    this.#size = size;
    this.#begun = false;
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
    watch.see(stage.camera);
  }

  #add({ packed, instead, fresh, elements, gains, ask }: FromWorker & { kind: "splats" }): void {
    const { stage } = this;
    if (!this.#begun) stage.begin(this.#size);
    this.#begun = true;
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

  /** Tiles take the place of others. */
  #recut({ gone, come, fresh, ask }: FromWorker & { kind: "tiles" }): void {
    const { stage } = this;
    if (!this.#begun) stage.begin(this.#size);
    this.#begun = true;
    if (gone.length || come.length) stage.recut(gone, come);
    this.#watch?.answered(ask);
    this.status.gaussians = stage.count;
    this.panel.tell("Gaussians", stage.count.toLocaleString());
    if (stage.count) this.#time("first");
    if (stage.count >= this.#gaussians / 2) {
      this.#time("half");
      stage.enough();
    }
    if (fresh && stage.view) this.#concealSoon();
  }

  #askFrame(number: number): void {
    const { show: _, ...choice } = this.panel.settings;
    this.#send({ kind: "frame", number, choice });
  }

  /** Frames of a live clip can be shown. */
  #playable({ begin, end, late }: FromWorker & { kind: "playable" }): void {
    if (!(this.#player instanceof LivePlayer)) return;
    this.#player.playable(begin, end);
    this.panel.tell("late", `${late.toLocaleString()} packets, ${this.#player.facts.late} frames`);
  }

  /** A frame is there: the next one is asked for when it is on the screen. */
  #frame({ number, packed, concealed, shownPackets, drawMs }: FromWorker & { kind: "frame" }): void {
    const { stage, panel } = this;
    if (!this.#begun && packed.count) stage.begin(this.#size);
    this.#begun ||= packed.count > 0;
    if (packed.count) stage.add(packed, true);
    this.status.gaussians = stage.count;
    panel.tell("Gaussians", stage.count.toLocaleString());
    panel.tell("motion concealed", concealed ? `${concealed.toLocaleString()} tracks` : "none");
    panel.tell("motion shown", `${shownPackets.toLocaleString()} packets`);
    if (this.#player instanceof LivePlayer) {
      const { held, buffer } = this.#player.facts;
      panel.tell("held", held ? `${held} frames` : "none");
      panel.tell("buffer", `${(1000 * buffer).toFixed(0)} ms`);
    } else panel.tell("late", `${this.#player?.skipped ?? 0} frames`);
    panel.tell("a frame takes", `${drawMs.toFixed(0)} ms`);
    if (packed.count) {
      this.#time("first");
      stage.enough();
    }
    const done = (): void => this.#player?.shown(number);
    if (stage.view) void stage.view.steady().then(done);
    else setTimeout(done);
  }

  #count({ counts, decodeMs, corrupt }: FromWorker & { kind: "counts" }): void {
    const { panel, status } = this,
      { packets, expected, bytes, seconds } = counts,
      share = expected ? packets / expected : 0,
      damaged = corrupt ? `, ${corrupt} damaged` : "";
    Object.assign(status, { packets, expected, way: counts.way, decodeMs });
    panel.progress(share);
    panel.tell("packets", `${packets.toLocaleString()} of ${expected.toLocaleString()}${damaged}`);
    panel.tell("missing", expected > packets ? `${(expected - packets).toLocaleString()} packets` : "none");
    panel.tell("received", `${(bytes / 1e6).toFixed(2)} MB`);
    panel.tell("rate", seconds > 0 ? `${((bytes * 8) / 1e6 / seconds).toFixed(1)} Mbit/s` : "-");
    panel.tell("lost on the way", counts.lost ? `${counts.lost} datagrams` : "none");
    panel.tell("time", `${seconds.toFixed(2)} s`);
    panel.tell("decoding", `${(decodeMs / 1000).toFixed(2)} s`);
    panel.tell("way", counts.way);
    if (status.lost && !status.finished) status.lost = null;
    const says = this.#player instanceof LivePlayer ? "Live." : "Receiving ...";
    if (share > 0 && !status.finished && !status.failed) panel.say(says);
    this.tell("progress", { packets, expected, bytes, gaussians: status.gaussians });
  }

  #fail(text: string): void {
    this.status.failed = text;
    this.panel.say(text, "bad");
    this.tell("error", { message: text });
  }

  /** What the PSNR is of where nothing was dropped on purpose. */
  #without(): string {
    return this.status.complete ? "no loss" : "of what arrived: nothing dropped";
  }

  #settingsChanged(): void {
    if (this.#player) return this.#player.again();
    if (this.stage.view) this.#conceal(); // what is painted before has no gains
  }

  /** Asks for new gains, not too often while packets come. */
  #concealSoon(): void {
    this.#timer ||= window.setTimeout(() => this.#conceal(), AGAIN_MS);
  }

  #conceal(): void {
    if (this.#player) return this.#player.again();
    const { show: _, ...choice } = this.panel.settings;
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#send({ kind: "conceal", choice, ask: ++this.#asked });
  }

  #flip(): void {
    this.stage.orbit.flip();
    this.#comparison.moved();
  }

  #fullScreen(): void {
    const done = document.fullscreenElement ? document.exitFullscreen() : this.host.requestFullscreen();
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

  #time(name: string): void {
    if (name in this.status.times) return;
    this.status.times[name] = NaN;
    this.stage.shown().then(() => this.#seen(name));
  }

  /** Something is on the screen. */
  #seen(name: string): void {
    const { times, began } = this.status,
      first = !Object.values(times).some((ms) => ms > 0);
    if (times[name] > 0 || this.#over.signal.aborted) return;
    const ms = (times[name] = performance.now() - began);
    if (first) this.tell("firstpicture", { ms, preview: name === "preview" });
  }

  #send(message: ToWorker): void {
    this.#worker.postMessage(message);
  }
}
