// Controls an element's stream from start to release: connects the worker, the stage and the panel.

import startReceiver, { notStarted } from "worker:receiver";
import { fromBase64 } from "../bytes.ts";
import type { Viewpoint } from "../codec/decoder.ts";
import type { FixedCamera } from "../model/camera.ts";
import { AnimationFrame } from "../render/animation_frame.ts";
import { type PackedPreview, packPreview } from "../render/packed_preview.ts";
import { ViewUpdates } from "../render/view_updates.ts";
import { nameOf } from "../transport/failover.ts";
import { withoutQuery } from "../transport/http_error.ts";
import type { LossSimulation } from "../transport/losses.ts";
import type { FromWorker, StreamInfo, ToWorker } from "../transport/messages.ts";
import { unlessAborted } from "./abort.ts";
import { addressOf, resolveSource, titleOf } from "./address.ts";
import { AutoRotation } from "./auto_rotation.ts";
import { Comparison } from "./comparison.ts";
import { createElement } from "./elements.ts";
import { type Dispatch, newStatus, type Status } from "./events.ts";
import { GainsRequests } from "./gains_requests.ts";
import { gaussianBudget } from "./gaussian_budget.ts";
import { Hotspots } from "./hotspots.ts";
import { EMBEDDED, embedCode, limitsOf, readLink, viewpointOf, writeLink } from "./links.ts";
import { Milestones } from "./milestones.ts";
import { showMetadata, showPacketStatistics } from "./packet_statistics.ts";
import { Panel } from "./panel.ts";
import { pictureOf } from "./screenshot.ts";
import { SequencePlayback, type WantedPlayback } from "./sequence_playback.ts";
import { Stage } from "./stage.ts";
import { TransferStatus } from "./transfer_status.ts";

/** Memory that is reserved on the GPU for updates, in multiples of the scene. */
const UPDATE_ROOM = 2;
/** Time without input after which the controls fade, milliseconds. */
const IDLE_MS = 4000;

/**
 * Starts the receiver. If the page's policy forbids this, such as one with Trusted Types, returns a worker that only
 * reports the error.
 */
function startWorker(): Worker {
  try {
    return startReceiver();
  } catch (error) {
    const failedWorker = Object.assign(new EventTarget(), { postMessage: () => undefined, terminate: () => undefined });
    setTimeout(() => failedWorker.dispatchEvent(new ErrorEvent("error", { message: (error as Error).message })));
    return failedWorker as unknown as Worker;
  }
}

export class Controller {
  readonly status: Status = newStatus();
  readonly stage: Stage;
  readonly panel: Panel;
  readonly #playback: SequencePlayback;
  readonly #milestones: Milestones;
  readonly #transferStatus: TransferStatus;
  readonly #worker: Worker;
  readonly #comparison: Comparison;
  readonly #rotation: AutoRotation;
  readonly #hotspots = new Hotspots(() => this.#cameraMoved());
  readonly #container = createElement("div", { class: "whole" });
  #poster: HTMLImageElement | null = null;
  #contextLosses = 0;
  #idleTimer = 0;
  #hasCheckedHeadset = false;
  readonly #cameraFrame: AnimationFrame;
  readonly #rotationFrame: AnimationFrame;
  #reportedViewpoint = "";
  /** Aborts the listeners when the element is released. */
  readonly #destroyed = new AbortController();
  /** Aborted with the error when the worker fails. */
  readonly #workerFailed = new AbortController();
  /** Aborted with the error when drawing fails. Replaced when drawing then succeeds. */
  #drawingFailed = new AbortController();
  /** Aborts the listeners for the window of the element's document. */
  #windowLeft = new AbortController();
  /** Address of the scene's file; empty for a scene inside the page. */
  #file = "";
  /** Number of elements in the whole stream (see `StreamInfo.numElements`). */
  #numElements = 0;
  #size = 1;
  /** Number of redundant Gaussians among the drawn ones. */
  #copies = 0;
  /** True once Gaussians of the scene, not of a preview, are drawn. */
  #started = false;
  #viewUpdates: ViewUpdates | null = null;
  readonly #gains = new GainsRequests(() => this.#conceal());

  /** `closed` is called when the window of the element's document is closed. Its elements stay connected. */
  constructor(
    readonly host: HTMLElement & { readonly updates: boolean; autorotate: string | null },
    root: ShadowRoot,
    readonly dispatch: Dispatch,
    readonly closed: () => void,
    retry: () => void,
    wanted: WantedPlayback,
  ) {
    this.#playback = new SequencePlayback(
      () => this.panel,
      (number) => this.#send({ kind: "frame", number, simulation: this.#simulation }),
      wanted,
    );
    this.#worker = startWorker(); // first, because starting a thread takes time
    this.#worker.addEventListener("message", ({ data }: MessageEvent<FromWorker>) => this.#onMessage(data));
    const fail = (error: Error): void => {
      if (!this.#destroyed.signal.aborted) this.#transferStatus.fail(error.message);
    };
    const failWith = (failed: AbortController, error: Error): void => {
      if (failed.signal.aborted) return; // reported before
      failed.abort(error);
      fail(error);
    };
    this.#worker.addEventListener("error", ({ message }) =>
      failWith(this.#workerFailed, new Error(message || notStarted)),
    );
    const title = titleOf(host);
    this.stage = new Stage(
      () => {
        const { aborted, reason } = this.#drawingFailed.signal;
        if (aborted) {
          this.#drawingFailed = new AbortController();
          this.#transferStatus.withdraw(reason.message);
        }
        this.#conceal();
      },
      (error) => failWith(this.#drawingFailed, error),
      title,
    );
    this.#cameraFrame = new AnimationFrame(host);
    this.#rotationFrame = new AnimationFrame(host);
    this.#rotation = new AutoRotation(
      this.stage.orbit,
      this.#rotationFrame,
      () => (this.panel.rotating = this.#rotation.running),
    );
    const src = host.getAttribute("src"),
      address = src && addressOf(src, host.baseURI),
      embed = (): string | null => address && embedCode(address, import.meta.url, attributesOf(host, EMBEDDED)),
      copies = { "copy link": () => this.link, ...(embed() ? { "copy embed code": () => embed()! } : {}) };
    this.panel = new Panel(
      {
        changed: () => this.#settingsChanged(),
        flip: () => this.stage.orbit.flip(),
        reset: () => this.stage.orbit.reset(),
        rotate: () => void (host.autorotate = this.#rotation.isOn ? null : ""),
        retry,
        fullScreen: host.ownerDocument.fullscreenEnabled ? () => this.#toggleFullScreen() : null,
        copies,
      },
      title,
    );
    this.#transferStatus = new TransferStatus(this.status, this.panel, dispatch);
    this.#milestones = new Milestones(this.status, dispatch, this.#destroyed.signal);
    this.#comparison = new Comparison(
      this.stage,
      () => this.panel.settings.show,
      (psnr) => this.panel.setRow("PSNR", this.#psnrText(psnr)),
    );
    const hotspots = createElement("div", { class: "hotspots" }, this.#hotspots.slot);
    this.#container.append(this.stage.surface, this.#comparison.canvas, hotspots, this.panel.element);
    root.replaceChildren(this.#container);
    this.stage.onContextLost = () => {
      this.#contextLosses++;
      this.#viewUpdates?.repeat();
    };
    this.stage.onChange = () => {
      this.#comparison.pictureChanged();
      this.#cameraMoved();
    };
    // Connects before anything is set up for drawing, which takes longer than the first packets.
    this.#open().catch(fail);
    this.#setUp();
    void this.stage.open();
  }

  /** Releases all resources. */
  destroy(): void {
    this.#destroyed.abort(new Error("this <splat-wire> was removed or restarted"));
    this.#container.remove(); // the page may keep the element
    this.#windowLeft.abort();
    this.#rotation.destroy();
    clearTimeout(this.#idleTimer);
    this.#playback.destroy();
    this.#worker.terminate();
    this.#gains.skip();
    this.panel.destroy();
    this.#comparison.destroy();
    this.stage.destroy();
    this.#cameraFrame.cancel();
  }

  /** Name of the scene in links. */
  get #name(): string {
    return nameOf((this.host.getAttribute("src") ?? "").split(/[?#]/)[0]);
  }

  /** Applies a changed attribute that does not affect the stream. */
  applyAttribute(name: string): void {
    const value = this.host.getAttribute(name);
    if (name === "panel") {
      this.panel.element.hidden = value === "none";
      this.panel.open = value === "open";
    }
    if (name === "concealer") this.panel.setConcealers(this.panel.concealers, value);
    if (name === "gestures") this.stage.setCooperative(value === "cooperative" && !this.#isFullScreen);
    if (name === "up") this.stage.setUp(value ?? "");
    if (name === "viewpoint") this.#applyViewpoint(true);
    if (name === "poster") this.#showPoster(value);
    if (name === "camera-limits") this.stage.setLimits(limitsOf(value));
    if (name === "max-gaussians") this.#viewUpdates?.repeat();
    if (name === "updates") this.#follow();
    if (name === "autorotate") {
      this.#rotation.set(value);
      this.panel.rotating = this.#rotation.running;
    }
    this.stage.invalidate();
  }

  /** Link to this page with the current view and settings. */
  get link(): string {
    const isAlone = this.host.ownerDocument.querySelectorAll(this.host.localName).length < 2;
    return writeLink(this.panel.settings, this.viewpoint, isAlone ? null : this.#name);
  }

  get viewpoint(): Viewpoint {
    return this.stage.viewpoint;
  }

  get playback(): SequencePlayback {
    return this.#playback;
  }

  verify(): Promise<boolean> {
    const verify = (): Promise<boolean> => this.#transferStatus.verify(() => this.#send({ kind: "digest" }));
    return unlessAborted(verify, this.#destroyed.signal, this.#workerFailed.signal);
  }

  picture(camera: FixedCamera): Promise<string> {
    const isPending = (): boolean =>
      !this.#workerFailed.signal.aborted && (!this.#gains.settled || this.#viewUpdates?.settled === false);
    return this.#comparison.withoutComparison(() => {
      const { signal } = this.#drawingFailed;
      const cameraNow = (): FixedCamera => {
        const { clientWidth, clientHeight } = this.host;
        signal.throwIfAborted(); // drawing may have failed, and succeeded again
        return { width: Math.round((camera.height * clientWidth) / Math.max(clientHeight, 1)), ...camera };
      };
      const draw = (): Promise<string> => pictureOf(this.stage, cameraNow, isPending, () => this.#contextLosses);
      return unlessAborted(draw, this.#destroyed.signal, this.#workerFailed.signal, signal);
    });
  }

  #setUp(): void {
    const { host, stage } = this,
      { signal } = this.#destroyed,
      preview = host.getAttribute("preview"),
      concealer = host.getAttribute("concealer"),
      link = readLink(this.#name);
    this.applyAttribute("panel");
    stage.setUp(host.getAttribute("up") ?? "");
    stage.orbit.turned = link.turned;
    this.panel.set({ ...(concealer ? { concealer } : {}), ...link.settings });
    this.applyAttribute("gestures");
    this.applyAttribute("poster");
    this.applyAttribute("camera-limits");
    if (link.viewpoint) stage.setViewpoint(link.viewpoint);
    this.#applyViewpoint(false);
    this.applyAttribute("autorotate");
    this.panel.showNotice("loading", "Connecting ...");
    if (preview) this.#preview(() => packPreview(fromBase64(preview)));
    // only once the controls are used or the scene is touched: Chromium keeps no page that has used WebXR for the back
    // button
    this.panel.onUse(() => this.#offerHeadset());
    host.addEventListener(
      "pointerdown",
      ({ pointerType }) => {
        if (pointerType !== "mouse" || matchMedia("(pointer: coarse)").matches) this.#offerHeadset();
      },
      { signal, passive: true },
    );
    this.onAdopted();
    host.addEventListener("keydown", (event) => this.#key(event), { signal });
    host.addEventListener("fullscreenchange", () => this.#fullScreenChanged(), { signal });
    for (const name of ["pointerdown", "pointermove", "wheel", "keydown", "focusin"] as const)
      host.addEventListener(name, () => this.#onInput(name), { signal, passive: true });
    this.#onInput("");
  }

  /** Adds the button for a headset if there is one. Checks this once. */
  #offerHeadset(): void {
    if (this.#hasCheckedHeadset) return;
    this.#hasCheckedHeadset = true;
    navigator.xr?.isSessionSupported("immersive-vr").then(
      (supported) => supported && this.panel.addHeadset(() => this.#enterHeadset()),
      () => undefined, // the page may not use it
    );
  }

  #enterHeadset(): void {
    this.stage.enterHeadset().catch((error: Error) => this.panel.setMessage(`No headset: ${error.message}`, "bad"));
  }

  /** Shows the controls, which fade after some seconds without input. Input also pauses the rotation. */
  #onInput(name: string): void {
    if (name && name !== "pointermove") {
      this.#rotation.onInput();
      if (name !== "focusin") this.stage.flight.stop();
    }
    clearTimeout(this.#idleTimer);
    this.#container.classList.remove("idle");
    this.#idleTimer = window.setTimeout(() => this.#fade(), IDLE_MS);
  }

  /** Fades the controls, unless there is something to read. */
  #fade(): void {
    const { status, panel } = this,
      isRead = panel.open || panel.helpOpen || !status.gaussians || status.lost !== null || status.failed !== null;
    this.#container.classList.toggle("idle", !isRead);
  }

  #showPoster(url: string | null): void {
    this.#poster?.remove();
    this.#poster = null;
    if (!url || this.#started) return;
    this.#poster = createElement("img", { class: "poster", alt: "", src: url });
    this.stage.surface.prepend(this.#poster);
  }

  /** Removes the notice and the poster, because a picture is on the screen. */
  #onPicture(): void {
    this.panel.hideNotice();
    this.#poster?.remove();
    this.#poster = null;
  }

  /** Moves the hotspots and reports the camera, at most once per animation frame. */
  #cameraMoved(): void {
    if (this.#cameraFrame.isRequested) return;
    this.#cameraFrame.request(() => {
      const { stage, viewpoint } = this,
        text = JSON.stringify(viewpoint);
      if (!this.#hotspots.isEmpty) this.#hotspots.place(stage.camera, stage.size);
      if (text === this.#reportedViewpoint) return;
      this.#reportedViewpoint = text;
      this.dispatch("camerachange", viewpoint);
    });
  }

  #fullScreenChanged(): void {
    this.applyAttribute("gestures");
    this.panel.fullScreen = this.#isFullScreen;
  }

  /**
   * Follows the window of the element's document. It has its own pixel density, may be closed, and may be shown while
   * that of the script is hidden, which then has no frames and no observations.
   */
  onAdopted(): void {
    this.#windowLeft.abort();
    this.#windowLeft = new AbortController();
    const window = this.host.ownerDocument.defaultView as (Window & typeof globalThis) | null,
      { signal } = this.#windowLeft;
    for (const frame of [this.#cameraFrame, this.#rotationFrame]) frame.follow();
    this.stage.onAdopted();
    this.#followDensity(window, signal);
    if (!window) return;
    window.addEventListener("pagehide", ({ persisted }) => persisted || this.closed(), { signal });
    const { stage } = this,
      sizes = new window.ResizeObserver(() => stage.resize()),
      visibility = new window.IntersectionObserver((entries) => {
        stage.setVisible(entries[entries.length - 1].isIntersecting);
        this.#playback.setVisible(stage.isVisible);
        this.#rotation.setVisible(stage.isVisible);
      });
    sizes.observe(stage.surface);
    visibility.observe(this.host);
    signal.addEventListener("abort", () => {
      sizes.disconnect();
      visibility.disconnect();
    });
  }

  /** Adapts the canvas resolution to the pixel density, which changes with the screen and with zoom. */
  #followDensity(window: Window | null, signal: AbortSignal): void {
    const density = window?.matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
    this.stage.resize();
    density?.addEventListener("change", () => this.#followDensity(window, signal), { once: true, signal });
  }

  /** Applies the page's viewpoint. With `force`, also if the visitor has moved the camera. */
  #applyViewpoint(force: boolean): void {
    const viewpoint = viewpointOf(this.host.getAttribute("viewpoint"));
    if (!viewpoint) return;
    if (force) Object.assign(this.stage.orbit, { placed: false, touched: false, turned: false });
    this.stage.setViewpoint(viewpoint);
  }

  async #open(): Promise<void> {
    this.panel.setMessage("Connecting ...");
    await null; // the page may set attributes after it has inserted the element
    const { host } = this,
      embedded = host.ownerDocument.getElementById(host.getAttribute("data") ?? "");
    if (embedded) {
      const bytes = fromBase64(embedded.textContent!.trim());
      return this.#send({ kind: "open", session: null, name: "", file: "", bytes });
    }
    const src = host.getAttribute("src");
    if (!src) throw new Error("<splat-wire> has no src");
    const address = addressOf(src, host.baseURI);
    if (!address) throw new Error(`the src of <splat-wire> is not a valid URL: ${withoutQuery(src)}`);
    const source = await resolveSource(address, host.getAttribute("session"), host.getAttribute("fingerprint"));
    this.#file = source.file;
    this.#send({ kind: "open", ...source, bytes: null });
  }

  #onMessage(message: FromWorker): void {
    const { panel } = this;
    switch (message.kind) {
      case "preview":
        if (!this.#numElements) this.#preview(() => message);
        return;
      case "info":
        return this.#onStreamInfo(message.info);
      case "splats":
        return this.#add(message);
      case "tiles":
        return this.#replaceTiles(message);
      case "frame":
        return this.#frame(message);
      case "framing":
        this.stage.framingGaussians = message.packed;
        if (this.#started) this.stage.resize();
        return;
      case "playable":
        return this.#playback.playable(message);
      case "counts":
        return this.#onCounts(message);
      case "gains":
        if (!this.#gains.onAnswer(message.requestId)) return;
        panel.setRow("dropped on purpose", `${this.status.packets - message.numKept} packets`);
        return this.#comparison.show(message.gains, message.gainsWithoutCopies);
      case "update":
        return this.#update(message);
      case "updatemissed":
        panel.setMessage(`Not updated: ${message.reason}`, "bad");
        return this.dispatch("updatemissed", { reason: message.reason });
      case "note":
        return panel.setMessage(message.text);
      case "disconnect":
        return this.#transferStatus.lost(message.reason, message.retryMs);
      case "finished":
        return this.#finished(message.outcome, message.complete);
      case "failed":
        return this.#transferStatus.fail(message.text);
      case "digest":
        return this.#transferStatus.verified(message.isVerified);
    }
  }

  #finished(outcome: string, complete: boolean): void {
    this.status.complete = complete;
    this.stage.end();
    if (this.stage.renderer) this.#conceal();
    this.#playback.end();
    this.#transferStatus.finished(outcome, complete, this.#playback.live);
    this.#follow();
  }

  /** Shows a preview until the scene arrives. An invalid preview is reported but is no failure. */
  #preview(read: () => PackedPreview): void {
    try {
      this.stage.preview(read()).then(() => this.#milestones.record("preview"));
      this.#onPicture();
      this.panel.setMessage("A preview; the scene is on its way.");
    } catch (error) {
      this.panel.setMessage((error as Error).message);
    }
  }

  #onStreamInfo(info: StreamInfo): void {
    const { numElements, size, middle, viewpoint, extent, up, viewDependent, concealers, sequence } = info,
      { stage } = this;
    this.#gains.skip(); // those of an earlier stream are not answered
    this.#playback.begin(sequence, stage.isVisible);
    this.panel.setConcealers(concealers);
    showMetadata(this.panel, info, this.host.hasAttribute("aria-label"));
    this.#numElements = numElements;
    this.#size = size;
    this.#started = false;
    this.#copies = 0;
    stage.background(info.background);
    stage.antialias(info.antialiased);
    if (up && !this.host.getAttribute("up")) stage.setUp(up);
    if (viewpoint) stage.setViewpoint(viewpoint);
    if (middle) stage.pointCameraAt(middle, size);
    stage.extent = extent;
    stage.framingGaussians = null;
    this.#viewUpdates = null;
    stage.onCamera = null;
    if (!viewDependent) return;
    const viewUpdates = new ViewUpdates(size, (camera, requestId) => {
      const budget = gaussianBudget(this.host.getAttribute("max-gaussians"), this.#contextLosses);
      this.#send({ kind: "view", camera, budget, requestId });
    });
    this.#viewUpdates = viewUpdates;
    stage.onCamera = (camera) => viewUpdates.onCamera(camera);
    stage.reportCamera();
  }

  #add({
    packed,
    replaceAll,
    hasNew,
    elements,
    copies,
    gains,
    gainsWithoutCopies,
    requestId,
  }: FromWorker & { kind: "splats" }): void {
    this.#start();
    this.#copies = copies;
    this.stage.add(packed, replaceAll);
    this.#viewUpdates?.onAnswer(requestId);
    if (gains) this.#comparison.show(gains, gainsWithoutCopies);
    this.#gaussiansChanged(elements, hasNew);
  }

  /** Requests updates once the scene is complete, while the page wants them. */
  #follow(): void {
    if (this.status.complete && this.#file) this.#send({ kind: "follow", file: this.host.updates ? this.#file : "" });
  }

  /** Swaps an update in: removed Gaussians disappear in the same picture that first shows the new ones. */
  #update({ hidden, packed, numRemoved, numNew, gaussians }: FromWorker & { kind: "update" }): void {
    const { stage, panel, status } = this;
    if (hidden) stage.update(hidden, packed);
    else stage.add(packed, true);
    this.#copies = 0;
    if (this.#dropsPackets) this.#conceal(); // the gains are those of the Gaussians before the update
    this.#numElements = status.gaussians = gaussians;
    panel.setRow("Gaussians", gaussians.toLocaleString());
    panel.setMessage(`Updated: ${numRemoved} Gaussians removed, ${numNew} new.`);
    void stage.shown().then(() => this.dispatch("update", { removed: numRemoved, added: numNew, gaussians }));
  }

  /** Replaces tiles. */
  #replaceTiles({ removed, added, hasNew, requestId }: FromWorker & { kind: "tiles" }): void {
    this.#start();
    if (removed.length || added.length) this.stage.replaceTiles(removed, added);
    this.#viewUpdates?.onAnswer(requestId);
    this.#gaussiansChanged(this.stage.count, hasNew || (removed.length > 0 && this.#dropsPackets));
  }

  /**
   * Draws a frame, then requests the next one: with WebGL once the frame is on the screen. Painting without WebGL does
   * not hold it back.
   */
  #frame(message: FromWorker & { kind: "frame" }): void {
    const { number, packed } = message,
      { stage } = this;
    if (packed.count) {
      this.#start();
      stage.antialias(message.antialiased);
      stage.add(packed, true);
    }
    this.#playback.showStatistics(message);
    this.#gaussiansChanged(packed.count ? this.#numElements : 0, false);
    const done = (): void => this.#playback.shown(number);
    if (stage.renderer) void stage.renderer.replacementSorted().then(done);
    else setTimeout(done);
  }

  /** Replaces the preview when the first Gaussians of the scene arrive. */
  #start(): void {
    const room = this.host.updates ? UPDATE_ROOM : 1,
      // `#numElements` of a clip counts the keyframes and motion of all groups, not the Gaussians of a frame
      hasUnknownSize = this.#viewUpdates || this.#playback.isSequence;
    if (!this.#started) this.stage.begin(this.#size, hasUnknownSize ? 0 : room * this.#numElements);
    this.#started = true;
  }

  /** True if packets are dropped on purpose, so that each tile needs its own gains. */
  get #dropsPackets(): boolean {
    const { lossRate, sentShare } = this.panel.settings;
    return lossRate > 0 || sentShare < 1;
  }

  /**
   * Updates the status after Gaussians are drawn. `elements` is the number of elements so far that counts for the
   * milestones `first` and `half`; a frame with Gaussians counts as the whole clip. `hasNew`: some are not concealed.
   */
  #gaussiansChanged(elements: number, hasNew: boolean): void {
    const { stage } = this;
    this.status.gaussians = stage.count - this.#copies;
    this.panel.setRow("Gaussians", this.status.gaussians.toLocaleString());
    const shown = (): Promise<void> => stage.shown();
    if (elements || !this.#numElements) {
      this.#onPicture();
      this.#milestones.recordWhen("first", shown);
    }
    if (elements >= this.#numElements / 2) {
      this.#milestones.recordWhen("half", shown);
      stage.startWebGL();
    }
    if (hasNew && stage.renderer) this.#gains.soon();
  }

  #onCounts(message: FromWorker & { kind: "counts" }): void {
    const { packets, expected, bytes, transport } = message.counts;
    Object.assign(this.status, { packets, expected, transport, way: transport, decodeMs: message.decodeMs });
    showPacketStatistics(this.panel, message);
    this.#transferStatus.progress(this.#playback.live, message.droppedGroups);
    this.dispatch("progress", { packets, expected, bytes, gaussians: this.status.gaussians });
  }

  /** Text about the PSNR, null if there is no difference. The reference picture has only what arrived. */
  #psnrText(psnr: string | null): string {
    if (this.status.complete) return psnr ?? "no loss";
    return `of what arrived: ${this.#dropsPackets ? (psnr ?? "no difference") : "nothing dropped"}`;
  }

  #settingsChanged(): void {
    if (this.#playback.isSequence) return this.#playback.redraw();
    if (this.stage.renderer) this.#conceal(); // painted pictures have no gains
  }

  #conceal(): void {
    if (this.#playback.isSequence) return this.#playback.redraw();
    if (!this.#numElements) return; // the worker has no scene yet, and would not answer
    const simulation = this.#simulation,
      isWhole = this.status.complete && !simulation.lossRate && simulation.sentShare === 1 && !this.#copies;
    if (!isWhole) {
      this.#comparison.awaitGains();
      return this.#send({ kind: "conceal", simulation, requestId: this.#gains.next() });
    }
    this.#gains.skip();
    this.panel.setRow("dropped on purpose", "0 packets");
    this.#comparison.show(null, null);
  }

  /** Simulated losses and concealer chosen in the panel. */
  get #simulation(): LossSimulation {
    const { show: _, ...simulation } = this.panel.settings;
    return simulation;
  }

  /** True if this element, and not an ancestor, is full screen. */
  get #isFullScreen(): boolean {
    return (this.host.getRootNode() as Document | ShadowRoot).fullscreenElement === this.host;
  }

  #toggleFullScreen(): void {
    const done = this.#isFullScreen ? this.host.ownerDocument.exitFullscreen() : this.host.requestFullscreen();
    done.catch((error: Error) => this.panel.setMessage(`Full screen failed: ${error.message}`));
  }

  #key(event: KeyboardEvent): void {
    const origin = event.composedPath()[0] as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (origin.isContentEditable || origin.matches("input, select, textarea")) return;
    if (event.key === "f") this.stage.orbit.flip();
    else if (event.key === "h") this.panel.element.hidden = !this.panel.element.hidden;
    else if (event.key === "?") this.panel.showHelp(!this.panel.helpOpen);
    else if (event.key === " " && this.#playback.isSequence && !origin.matches("button, summary"))
      this.#playback.play(this.#playback.paused);
    else if (!this.stage.controls.key(event.key, event.shiftKey)) return;
    event.preventDefault();
  }

  #send(message: ToWorker): void {
    this.#worker.postMessage(message);
  }
}

/** Returns those of some attributes that an element has. */
function attributesOf(element: Element, names: readonly string[]): Record<string, string> {
  return Object.fromEntries(
    names.flatMap((name) => (element.hasAttribute(name) ? [[name, element.getAttribute(name)!]] : [])),
  );
}
