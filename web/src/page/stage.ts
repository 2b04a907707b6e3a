// Drawing area: paints the first pictures in software, then switches to the WebGL renderer.

import { Vec3 } from "playcanvas";

import type { BoundingSphere, Viewpoint } from "../codec/decoder.ts";
import type { Camera } from "../model/camera.ts";
import { AnimationFrame } from "../render/animation_frame.ts";
import { Controls } from "../render/controls.ts";
import { frameScene, sceneCore } from "../render/framing.ts";
import { FreeSpace } from "../render/free_space.ts";
import { loadRenderer } from "../render/load.ts";
import { Orbit, type WindowPosition } from "../render/orbit.ts";
import { hide, type Packed, type Tile } from "../render/packed.ts";
import type { PackedPreview } from "../render/packed_preview.ts";
import { cameraFromPose, FAR_CLIP, halfHeight } from "../render/projection.ts";
import type { SceneCore } from "../render/scene_core.ts";
import { paint } from "../render/software_renderer.ts";
import { acquireContext, type ContextOwner, offerContext, releaseContext } from "../render/webgl_contexts.ts";
import type { WebGLRenderer } from "../render/webgl_renderer.ts";
import { delay, periodicPause } from "../scheduler.ts";
import { waitOrOnline } from "../transport/backoff.ts";
import { isFinal } from "../transport/http_error.ts";
import { createElement } from "./elements.ts";
import { Flight } from "./flight.ts";

/**
 * Thresholds that start WebGL after the first picture: number of Gaussians, arrived or expected, or time in
 * milliseconds. Setting it up blocks the page, for a second with software rendering.
 */
const WEBGL_GAUSSIANS = 50_000,
  WEBGL_DELAY_MS = 3000;
/** Time limit for an animation frame, milliseconds. An invisible page has none, but its promises must resolve. */
const FRAME_TIMEOUT_MS = 100;
/** Delay before a lost WebGL context is requested again, milliseconds. It doubles with each further failure. */
const CONTEXT_RETRY_MS = 1000;
/** Failures in a row after which no context is requested again. Browsers refuse contexts for two minutes after some. */
const MAX_CONTEXT_FAILURES = 8;
/**
 * Time after which a renderer that could not be loaded is requested again, and an element that becomes visible requests
 * a context once more, milliseconds.
 */
const RECOVERY_MS = 60_000;

/** Display time of a hint, milliseconds. */
const HINT_MS = 2000;

export class Stage implements ContextOwner {
  /** Element that receives gestures and contains the canvases. */
  readonly surface = createElement("div", {
    class: "scene",
    tabindex: "0",
    role: "application",
    "aria-roledescription": "three-dimensional scene",
  });
  /** Canvas of the software-painted pictures, in front of the WebGL canvas until that has a picture. */
  readonly paintedCanvas = createElement("canvas", { class: "first" });
  readonly orbit = new Orbit(
    () => this.invalidate(),
    () => this.#freeSpace(),
    (at) => this.#pick(at),
  );
  readonly controls = new Controls(this.surface, this.orbit, (text) => this.#showHint(text));
  readonly #flightFrame = new AnimationFrame(this.surface);
  readonly flight = new Flight(this.orbit, this.#flightFrame);
  #limits: readonly number[] | null = null;
  readonly #hint = createElement("p", { class: "hint" });
  #hintTimer = 0;
  renderer: WebGLRenderer | null = null;
  isVisible = true;
  /** Sphere around all frames of a clip, world units; null if the stream has none. */
  extent: BoundingSphere | null = null;
  /** Gaussians that determine the default viewpoint; null if the drawn ones do. */
  framingGaussians: Packed | null = null;
  /** Callback with the camera of each picture. */
  onCamera: ((camera: Camera) => void) | null = null;
  /** Callback after the loss of the WebGL context. */
  onContextLost: (() => void) | null = null;
  /** Callback after each change of the picture. */
  onChange: (() => void) | null = null;
  #parts: Packed[] = [];
  /** Drawn tiles of a scene with levels. */
  readonly #tiles = new Map<number, Packed>();
  #size = 1;
  #count = 0;
  /** Number of Gaussians of the whole scene, 0 if unknown. */
  #expected = 0;
  /** True if no more Gaussians will arrive. */
  #ended = false;
  /** True once Gaussians of a scene, not of a preview, are drawn. */
  #begun = false;
  /** Centre and size of a scene, as far as known before its Gaussians. */
  #pointedAt: { readonly middle: readonly number[]; readonly size: number } | null = null;
  /** Number of Gaussians when the camera was last framed. */
  #framedCount = 0;
  /** Free space for the camera, and the number of Gaussians that it was computed from. */
  #freeSpaceGrid: FreeSpace | null = null;
  #spaceCount = 0;
  #background: readonly number[] = [0, 0, 0];
  #antialiased = false;
  #waitingForRenderer: ((renderer: WebGLRenderer) => void)[] = [];
  #painting: Promise<void> | null = null;
  #stale = false;
  #shown: (() => void)[] = [];
  #opening = false;
  #destroyed = false;
  /** Number of lost or refused WebGL contexts in a row, 0 before the first loss. */
  #contextFailures = 0;
  #failedAt = 0;
  #retryTimer = 0;
  #startWebGL: () => void = () => undefined;
  readonly #webGLWanted = new Promise<void>((resolve) => (this.#startWebGL = resolve));

  /** `opened` is called with each new renderer, `failed` if none can be created. */
  constructor(
    readonly opened: (renderer: WebGLRenderer) => void,
    readonly failed: (error: Error) => void,
    readonly title: string,
  ) {
    this.surface.setAttribute("aria-label", `${title}: arrow keys rotate, plus and minus zoom, Home resets the camera`);
    describe(this.paintedCanvas, title);
    this.surface.append(this.paintedCanvas, this.#hint);
  }

  /** Sets whether the wheel and one-finger gestures are left to the page. */
  setCooperative(cooperative: boolean): void {
    this.controls.cooperative = cooperative;
    this.surface.classList.toggle("cooperative", cooperative);
  }

  #showHint(text: string): void {
    this.#hint.textContent = text;
    this.#hint.classList.add("shown");
    clearTimeout(this.#hintTimer);
    this.#hintTimer = window.setTimeout(() => this.#hint.classList.remove("shown"), HINT_MS);
  }

  /** Returns the free space for the camera; null before the first Gaussians. */
  #freeSpace(): FreeSpace | null {
    if (this.count && this.#count >= 1.5 * this.#spaceCount) {
      this.#freeSpaceGrid = new FreeSpace(sceneCore(this.#parts), this.#parts);
      this.#spaceCount = this.#count;
    }
    return this.#freeSpaceGrid;
  }

  /** Returns the point of the scene at a window position, or next to it. */
  #pick(at: WindowPosition | null): Vec3 | null {
    const { clientWidth: width, clientHeight: height } = this.surface,
      camera = cameraFromPose(this.orbit.pose(), 1, width, height),
      { x, y } = at ?? { x: width / 2, y: height / 2 },
      point = this.renderer?.pick(this.#parts, camera, x, y);
    return point ? new Vec3(...point) : null;
  }

  /** Shows the scene in a headset. Throws if there is no renderer or no session. */
  async enterHeadset(): Promise<void> {
    if (!this.renderer) throw new Error("nothing is drawn yet");
    await this.renderer.enterHeadset();
  }

  /** Loads the renderer and starts drawing, if the element is visible and a WebGL context is free. */
  async open(): Promise<void> {
    if (this.#opening || this.renderer || this.#destroyed || this.#contextFailures > MAX_CONTEXT_FAILURES) return;
    this.#opening = true;
    try {
      await this.#open();
    } catch (error) {
      this.release(); // a renderer that is incomplete
      releaseContext(this);
      if (this.#retryTimer) return; // visible again, or offered a context, before the retry
      if (!this.#contextFailures) this.failed(error as Error);
      else this.#openLater(this.#contextFailures + 1, error as Error);
    } finally {
      this.#opening = false;
    }
  }

  async #open(): Promise<void> {
    if (this.#count) await this.shown();
    const Renderer = await loadRenderer().catch((error: unknown) => {
      if (isFinal(error)) throw error;
      void waitOrOnline(RECOVERY_MS).then(() => this.open());
      throw new Error("The renderer is missing; reload the page.");
    });
    setTimeout(this.#startWebGL, WEBGL_DELAY_MS);
    await this.#webGLWanted;
    if (this.#count) await this.shown();
    if (this.#destroyed || !this.isVisible || !acquireContext(this)) return;
    const canvas = document.createElement("canvas");
    describe(canvas, this.title);
    this.surface.prepend(canvas);
    try {
      this.renderer = new Renderer(canvas, this.orbit);
    } catch (error) {
      canvas.remove();
      throw new Error(`This browser has no WebGL 2 (${(error as Error).message}).`);
    }
    const renderer = this.renderer;
    canvas.addEventListener("webglcontextlost", () => this.#contextLost(renderer));
    renderer.watcher = (camera) => this.#reportCamera(camera);
    renderer.background(this.#background);
    renderer.antialias(this.#antialiased);
    renderer.begin(this.#size, this.#expected);
    if (this.#ended) renderer.end();
    if (this.#tiles.size)
      renderer.replaceTiles(
        [],
        Array.from(this.#tiles, ([tile, packed]) => ({ tile, packed })),
      );
    else for (const part of this.#parts) renderer.add(part);
    // `sorted` gives up after its time limit; the painted picture stays until the renderer has one
    do await renderer.sorted();
    while (this.renderer === renderer && this.#count && !renderer.shows);
    if (this.renderer !== renderer) return;
    for (const work of this.#waitingForRenderer.splice(0)) work(renderer);
    this.opened(renderer);
    this.paintedCanvas.classList.remove("shown");
    for (const resolve of this.#shown.splice(0)) resolve();
  }

  /** Handles the loss of the WebGL context: paints in software until there is another one. */
  #contextLost(renderer: WebGLRenderer): void {
    if (this.renderer !== renderer) return;
    const isPicture = renderer.failed && renderer.fixed !== null, // it needs more memory than the page, which is fine
      failures = isPicture ? Math.max(this.#contextFailures, 1) : renderer.failuresAfter(this.#contextFailures);
    this.release();
    releaseContext(this);
    if (!isPicture) this.onContextLost?.();
    this.#openLater(failures, renderer.reason);
  }

  /** Opens after a pause, or reports the error after too many failures. */
  #openLater(failures: number, error: Error): void {
    clearTimeout(this.#retryTimer);
    this.#contextFailures = failures;
    this.#failedAt = performance.now();
    if (failures > MAX_CONTEXT_FAILURES) return this.failed(error);
    this.#retryTimer = window.setTimeout(
      () => {
        this.#retryTimer = 0;
        void this.open();
      },
      CONTEXT_RETRY_MS * 2 ** (failures - 1),
    );
  }

  /** Releases the WebGL context and paints in software. */
  release(): void {
    const renderer = this.renderer;
    this.renderer = null;
    renderer?.destroy();
    this.invalidate();
  }

  onContextAvailable(): void {
    void this.open();
  }

  /** Sets whether the element is visible. Invisible elements may lose their WebGL context. */
  setVisible(isVisible: boolean): void {
    if (this.isVisible === isVisible) return;
    this.isVisible = isVisible;
    if (!isVisible) return offerContext();
    if (performance.now() - this.#failedAt > RECOVERY_MS)
      this.#contextFailures = Math.min(this.#contextFailures, MAX_CONTEXT_FAILURES);
    this.invalidate();
    void this.open();
  }

  /** Releases all resources. */
  destroy(): void {
    this.#destroyed = true;
    this.flight.stop();
    clearTimeout(this.#hintTimer);
    clearTimeout(this.#retryTimer);
    this.#parts = [];
    this.framingGaussians = null;
    this.#count = 0;
    this.release();
    releaseContext(this);
    this.#startWebGL();
    for (const resolve of this.#shown.splice(0)) resolve();
  }

  /** Calls `work` with the renderer, now or once it exists. */
  withRenderer(work: (renderer: WebGLRenderer) => void): void {
    if (this.renderer) work(this.renderer);
    else this.#waitingForRenderer.push(work);
  }

  /** Shows a preview if nothing is shown yet. Resolves when it is on the screen. */
  async preview({ packed, background, size }: PackedPreview): Promise<void> {
    if (this.#count) return;
    this.begin(size);
    this.#begun = false;
    this.background(background);
    this.add(packed);
    await this.shown();
  }

  /** Sets whether opacity decreases for Gaussians below the size of a pixel. */
  antialias(antialiased: boolean): void {
    if (antialiased === this.#antialiased) return;
    this.#antialiased = antialiased;
    this.renderer?.antialias(antialiased);
  }

  background(colour: readonly number[]): void {
    this.#background = colour;
    this.renderer?.background(colour);
  }

  /** Sets the initial viewpoint, unless the visitor has moved the camera or a viewpoint was set before. */
  setViewpoint({ eye, target, up }: Viewpoint): void {
    if (this.orbit.touched || this.orbit.placed) return;
    const scaled = (point: readonly number[]): Vec3 => new Vec3(...point.map((value) => value / this.#size));
    this.orbit.place(scaled(eye), scaled(target), new Vec3(...up));
    this.#framedCount = 0;
    this.#frame();
    this.invalidate();
  }

  /** Points the camera at a scene with known centre and size but no Gaussians yet, unless it was moved or placed. */
  pointCameraAt(middle: readonly number[], size: number): void {
    this.#pointedAt = { middle, size };
    if (this.orbit.touched || this.orbit.placed || this.#framedCount || !this.#hasSize) return;
    const frustum = this.#frustum(),
      radius = size / this.#size,
      halfAngle = Math.atan(Math.min(frustum.across, frustum.down));
    this.orbit.begin(
      middle.map((value) => value / this.#size),
      radius / Math.sin(halfAngle),
    );
    this.invalidate();
  }

  /** True if the element has a size. It has none while hidden or before layout. */
  get #hasSize(): boolean {
    return this.surface.clientWidth > 0 && this.surface.clientHeight > 0;
  }

  /** Returns half the width and height of the window at distance 1. */
  #frustum(): { across: number; down: number } {
    const { clientWidth: width, clientHeight: height } = this.surface,
      down = halfHeight(width, height);
    return { across: (down * width) / Math.max(height, 1), down };
  }

  /** Returns the sphere to frame, in the renderer's unit of length: that of the stream, else the current scene. */
  #extent(core: SceneCore): BoundingSphere {
    if (!this.extent) return core;
    const { middle, radius } = this.extent;
    return { middle: middle.map((value) => value / this.#size), radius: radius / this.#size };
  }

  /** Frames the current scene, unless the camera was moved, or placed where it can draw the scene. */
  #frame(): void {
    const { orbit } = this;
    if (orbit.touched || !this.count || !this.#hasSize) return;
    if (orbit.placed && (!this.#begun || this.#framedCount)) return;
    const { across, down } = this.#frustum(),
      framing = this.#begun && this.framingGaussians, // not of a preview, which has another unit
      parts = framing ? [framing] : this.#parts,
      core = sceneCore(parts);
    this.#framedCount = framing ? Infinity : this.#count;
    if (orbit.placed) {
      orbit.placed = orbit.pose().position.distance(new Vec3(...core.middle)) <= FAR_CLIP;
      if (orbit.placed) return;
    }
    frameScene(orbit, core, new FreeSpace(core, parts), across, down, this.#extent(core));
  }

  /** Announces that no more Gaussians will arrive. */
  end(): void {
    this.#ended = true;
    this.renderer?.end();
    if (this.#count > this.#framedCount) this.#frame();
    this.invalidate();
  }

  /** Limits the camera: least and largest distance from the target, world units, and polar angle, degrees. */
  setLimits(limits: readonly number[] | null): void {
    this.#limits = limits;
    this.#applyLimits();
    this.#frame();
    this.invalidate();
  }

  #applyLimits(): void {
    const [near, far, top, bottom] = this.#limits ?? [];
    const pitch = (polar: number): number => (polar * Math.PI) / 180 - Math.PI / 2;
    this.orbit.limit(
      this.#limits && { near: near / this.#size, far: far / this.#size, low: pitch(top), high: pitch(bottom) },
    );
  }

  /** Moves the camera to a viewpoint. Resolves to false if the movement is stopped. */
  fly({ eye, target, up }: Viewpoint, seconds: number): Promise<boolean> {
    const scaled = (point: readonly number[]): Vec3 => new Vec3(...point.map((value) => value / this.#size));
    this.orbit.reorient(new Vec3(...up).normalize());
    return this.flight.start(this.orbit.stateOf(scaled(eye), scaled(target)), seconds);
  }

  /** Sets the up axis of the scene. */
  setUp(up: string): void {
    if (this.orbit.placed) return;
    this.orbit.setUp(up);
    this.#frame();
    this.invalidate();
  }

  /** Reports a camera unless its picture has no pixels. A fixed camera has a size independent of the element. */
  #reportCamera(camera: Camera): void {
    if (this.#hasSize || this.renderer?.fixed) this.onCamera?.(camera);
  }

  /** Reports the current camera. */
  reportCamera(): void {
    this.#reportCamera(this.camera);
  }

  /** Current camera, world units. */
  get camera(): Camera {
    return (
      this.renderer?.camera ??
      cameraFromPose(this.orbit.pose(), this.#size, this.surface.clientWidth, this.surface.clientHeight)
    );
  }

  /**
   * Starts a new scene of this size, world units, and with this number of Gaussians, 0 if unknown. The camera stays in
   * place.
   */
  begin(size: number, expected = 0): void {
    this.#begun = true;
    this.orbit.rescale(this.#size / size);
    this.flight.stop();
    this.#parts = [];
    this.#tiles.clear();
    this.#size = size;
    this.#count = this.#framedCount = this.#spaceCount = 0;
    this.#freeSpaceGrid = null;
    this.#expected = expected;
    if (expected > WEBGL_GAUSSIANS) this.startWebGL();
    this.#ended = false;
    this.renderer?.begin(size, expected);
  }

  /** Replaces tiles. */
  replaceTiles(removed: readonly number[], added: readonly Tile[]): void {
    for (const tile of removed) this.#tiles.delete(tile);
    for (const { tile, packed } of added) this.#tiles.set(tile, packed);
    this.#parts = [...this.#tiles.values()];
    this.#count = this.#parts.reduce((sum, { count }) => sum + count, 0);
    if (this.#count >= 1.5 * this.#framedCount) this.#frame();
    this.renderer?.replaceTiles(removed, added);
    if (this.#count > WEBGL_GAUSSIANS) this.startWebGL();
    this.invalidate();
  }

  /** Adds Gaussians. If `replaces` is true, they replace all others. */
  add(packed: Packed, replaces = false): void {
    this.#parts = replaces ? [packed] : [...this.#parts, packed];
    this.#count = replaces ? packed.count : this.#count + packed.count;
    if (this.#count >= 1.5 * this.#framedCount) this.#frame();
    this.renderer?.add(packed, replaces);
    if (this.#count > WEBGL_GAUSSIANS) this.startWebGL();
    this.invalidate();
  }

  /** Hides Gaussians, by index in the order of arrival, and adds others in the same picture. */
  update(hidden: Int32Array, packed: Packed): void {
    let part = 0,
      first = 0;
    for (const n of hidden) {
      while (n >= first + this.#parts[part].count) first += this.#parts[part++].count;
      hide(this.#parts[part], n - first);
    }
    this.#parts = [...this.#parts, packed];
    this.#count += packed.count;
    this.renderer?.update(hidden, packed);
    this.invalidate();
  }

  /** Number of Gaussians; 0 if none is visible, as in an empty frame. */
  get count(): number {
    return this.#parts.some(({ opacities }) => opacities.some(Boolean)) ? this.#count : 0;
  }

  /** Starts WebGL, because enough Gaussians arrived. */
  startWebGL(): void {
    this.#startWebGL();
  }

  /** Resolves when the added Gaussians are on the screen; with WebGL, after five seconds in any case. */
  shown(): Promise<void> {
    if (this.renderer) return this.renderer.sorted();
    this.invalidate();
    return new Promise((resolve) => this.#shown.push(resolve));
  }

  /** Continues in the window that displays the element now. */
  onAdopted(): void {
    this.#flightFrame.follow();
    this.renderer?.onAdopted();
  }

  /** Adapts to the size of the element. Without a size the last picture stays. */
  resize(): void {
    if (!this.#hasSize) return;
    if (this.#pointedAt) this.pointCameraAt(this.#pointedAt.middle, this.#pointedAt.size);
    this.#frame();
    this.renderer?.resize();
    this.invalidate();
  }

  /** Current viewpoint, world units. */
  get viewpoint(): Viewpoint {
    const { eye, target, up } = this.orbit.viewpoint(),
      numbers = ({ x, y, z }: Vec3, unit: number): [number, number, number] => [unit * x, unit * y, unit * z];
    return { eye: numbers(eye, this.#size), target: numbers(target, this.#size), up: numbers(up, 1) };
  }

  /** Size of the scene, world units. */
  get size(): number {
    return this.#size;
  }

  /** Marks the picture as outdated, so that it is drawn again. */
  invalidate(): void {
    this.onChange?.();
    this.#stale = true;
    if (this.renderer) this.renderer.touch();
    else if (this.#count && this.isVisible) this.#painting ??= this.#paint();
  }

  /** Paints in software until nothing changes or there is a renderer. */
  async #paint(): Promise<void> {
    this.paintedCanvas.classList.add("shown");
    await null; // batches all changes of this task
    while (this.#stale && !this.renderer && !this.#destroyed) {
      const shown = this.#shown.splice(0),
        began = performance.now();
      this.#stale = false;
      this.#reportCamera(this.camera);
      const painted = {
        parts: this.#parts,
        background: this.#background,
        pose: this.orbit.pose(),
        antialiased: this.#antialiased,
      };
      // without a 2D context or memory, the renderer draws the first picture
      await paint(this.paintedCanvas, painted, periodicPause()).catch(() => this.startWebGL());
      const paintMs = performance.now() - began;
      await nextPaint();
      for (const resolve of shown) resolve();
      await Promise.race([this.#webGLWanted, delay(4 * paintMs)]); // leaves most of the time for decoding packets
    }
    this.#painting = null;
  }
}

/** Describes a canvas as a picture for screen readers. */
function describe(canvas: HTMLCanvasElement, title: string): void {
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Picture of ${title}`);
}

/** Resolves when the painted picture is on the screen. */
function nextPaint(): Promise<void> {
  return new Promise((resolve) => {
    requestAnimationFrame(() => setTimeout(resolve));
    setTimeout(resolve, FRAME_TIMEOUT_MS);
  });
}
