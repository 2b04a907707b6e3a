// WebGL renderer: a canvas, a camera and Gaussians. Draws frames only after changes.

import {
  AppBase,
  AppOptions,
  CameraComponentSystem,
  Color,
  Entity,
  FILLMODE_NONE,
  GAMMA_SRGB,
  GSPLATDATA_LARGE,
  GSplatComponentSystem,
  Mat4,
  Quat,
  RESOLUTION_FIXED,
  TONEMAP_NONE,
} from "playcanvas";

import type { Camera, FixedCamera } from "../model/camera.ts";
import { delay } from "../scheduler.ts";
import { AnimationFrame } from "./animation_frame.ts";
import { AsyncShaderDevice } from "./async_shader_device.ts";
import { cssZoomOf } from "./css_zoom.ts";
import { GpuFence, UploadSlices } from "./gpu_limits.ts";
import { HalfFloatTarget } from "./half_float_target.ts";
import { Headset } from "./headset.ts";
import type { Orbit } from "./orbit.ts";
import type { Packed, Tile } from "./packed.ts";
import { pickPoint } from "./pick.ts";
import { cameraFromPose, FAR_CLIP, halfHeight } from "./projection.ts";
import { COMMON, CORNER, FRAGMENT } from "./shaders.ts";
import { SingleMesh } from "./single_mesh.ts";
import { TiledMeshes } from "./tiled_meshes.ts";

/** Time limit for depth sorting in the worker, milliseconds. The picture is then used as it is. */
const SORT_MS = 5000;
/** Time after the last frame without changes at which the frame loop stops, milliseconds. */
const IDLE_MS = SORT_MS;

/**
 * While Gaussians arrive: bounds of the time between two uploads, milliseconds, and that time in multiples of the time
 * that the GPU needs for a picture. Each upload requires another depth sort and another picture.
 */
const MIN_INTERVAL_MS = 500,
  MAX_INTERVAL_MS = 4000,
  GPU_MULTIPLE = 4;
/** Interval of the checks of waiting uploads and pictures, milliseconds. */
const POLL_MS = 10;

/** Largest number of canvas pixels per CSS pixel. */
const MAX_PIXEL_RATIO = 2;

/** Time after which a view counts as stable, milliseconds. */
const STABLE_MS = 60_000;

/** Error message if an allocation failed, in the process or on the GPU. */
const TOO_LITTLE_MEMORY = "This device cannot draw the scene: too little memory.";

/** Internals of PlayCanvas's frame loop. */
interface FrameLoop {
  frameRequestId: number | null;
  requestAnimationFrame(): void;
  tick(...given: unknown[]): void;
  _inFrameUpdate: boolean;
}

/**
 * Internals of PlayCanvas: the sorter of each layer of each camera. Each change of what there is to sort has a version;
 * the Gaussians of an older version are drawn until `pendingSorted` is applied in a frame.
 */
interface SorterInternals {
  readonly gsplatDirector: { readonly camerasMap: Map<unknown, { readonly layersMap: Map<unknown, Layer> }> };
}
interface Layer {
  readonly gsplatManager: Manager | null;
}
interface Manager {
  readonly world: { readonly lastWorldStateVersion: number };
  readonly cpuSorter: {
    readonly jobsInFlight: number;
    readonly pendingSorted: { readonly version: number } | null;
  } | null;
}

/** Gaussians to hide in the frame that draws a version after `version`. */
interface Hiding {
  readonly which: Int32Array;
  readonly version: number;
}

export class WebGLRenderer {
  readonly #app: AppBase;
  readonly #camera: Entity;
  readonly #target: HalfFloatTarget;
  readonly #gpu: GpuFence;
  readonly #device: AsyncShaderDevice;
  /** True if the next frame waits for the GPU to finish the last one. */
  #waitsForGpu = false;
  readonly #mesh: SingleMesh;
  readonly #headset: Headset;
  /** Tiles of a scene with levels; null for other scenes. */
  #tiles: TiledMeshes | null = null;
  readonly #slices: UploadSlices;
  /** Gaussians that are not uploaded yet, the running upload, and the time of the last one. */
  #pending: Packed[] = [];
  /** Gaussians to hide once the pending ones are uploaded. */
  #hidden: Int32Array[] = [];
  /** Gaussians to hide once those that replace them are sorted. */
  #hiding: Hiding[] = [];
  #uploading: Promise<void> | null = null;
  #uploadedAt = performance.now();
  /** True until all Gaussians have arrived. */
  #isArriving = true;
  #size = 1;
  #fixed: FixedCamera | null = null;
  /** Pending picture size and half height at distance 1; null if unchanged. */
  #pendingSize: { readonly width: number; readonly height: number; readonly tangent: number } | null = null;
  /** Callbacks that wait for the next frame, for the next sorted frame, and until replaced Gaussians are sorted. */
  #frameWaiters: (() => void)[] = [];
  #sortedWaiters: (() => void)[] = [];
  #replacementWaiters: (() => void)[] = [];
  /** True if a sort has finished since the last frame. */
  #hasSortFinished = false;
  readonly #pose = new Mat4();
  /** True if the camera moved since it last rested. PlayCanvas skips sorting for a movement during a sort. */
  #moved = false;
  /** True if the Gaussians were replaced but not sorted yet. The old ones stay on the screen until then. */
  #replaced = false;
  /** True if everything added was sorted in the last frame. */
  #ready = false;
  /** True once Gaussians are on the screen. */
  shows = false;
  #destroyed = false;
  #drawnAt = 0;
  #loopStopped = false;
  readonly #nextFrame: AnimationFrame;
  /** Error that ended drawing; null if there is none. */
  #failure: Error | null = null;
  /** State of the memory since the last check: unchanged, changed, or drawn. */
  #memory: "checked" | "changed" | "drawn" = "checked";
  readonly #openedAt = performance.now();
  /** Callback with the camera of each frame, world units. */
  watcher: ((camera: Camera) => void) | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly orbit: Orbit,
  ) {
    const device = new AsyncShaderDevice(canvas, {
      antialias: false,
      alpha: false,
      powerPreference: "high-performance",
    });
    const options = new AppOptions();
    options.graphicsDevice = device;
    options.componentSystems = [CameraComponentSystem, GSplatComponentSystem];
    this.#app = new AppBase(canvas);
    this.#app.init(options);
    this.#app.setCanvasFillMode(FILLMODE_NONE);
    this.#app.autoRender = false;
    this.#camera = new Entity("camera", this.#app);
    const gsplat = this.#app.scene.gsplat;
    gsplat.dataFormat = GSPLATDATA_LARGE;
    gsplat.colorUpdateAngle = 0.1;
    const chunks = gsplat.material.getShaderChunks("glsl");
    chunks.set("gsplatCornerVS", CORNER);
    chunks.set("gsplatCommonVS", COMMON);
    chunks.set("gsplatPS", FRAGMENT);
    gsplat.material.update();
    this.#camera.addComponent("camera", {
      nearClip: 0.01,
      farClip: FAR_CLIP,
      toneMapping: TONEMAP_NONE,
      gammaCorrection: GAMMA_SRGB,
    });
    this.#device = device;
    this.#gpu = new GpuFence(device);
    this.#slices = new UploadSlices(this.#gpu, () => this.#destroyed);
    this.#target = new HalfFloatTarget(device, this.#camera.camera!);
    this.#mesh = new SingleMesh(this.#app);
    this.#headset = new Headset(this.#app, this.#camera, orbit, () => this.#onHeadset());
    this.#app.on("update", () => this.#beforeFrame());
    this.#app.systems.gsplat!.on("frame:request", () => this.touch());
    this.#app.scene.on("gsplat:sorted", () => {
      this.#hasSortFinished = true;
      if (this.#moved) this.touch();
    });
    this.#app.systems.gsplat!.on("frame:ready", (_camera: unknown, _layer: unknown, ready: boolean) =>
      this.#onSortReport(ready),
    );
    this.#app.on("postrender", () => this.#afterFrame());
    const loop = this.#app as unknown as FrameLoop,
      { tick } = loop,
      requestOfHeadset = loop.requestAnimationFrame.bind(loop);
    this.#nextFrame = new AnimationFrame(canvas);
    loop.requestAnimationFrame = () => {
      this.#nextFrame.cancel();
      if (this.#app.xr?.session) return requestOfHeadset();
      loop.frameRequestId = null; // PlayCanvas would cancel a frame of that number in the script's window
      this.#nextFrame.request(loop.tick);
    };
    loop.tick = (...given) => {
      this.#try(() => tick(...given));
      loop._inFrameUpdate = false; // else the app could not be destroyed after an error
    };
    this.#app.on("frameend", () => this.#stopIdleLoop());
    this.resize();
    this.#applySize();
    this.#app.start();
  }

  get count(): number {
    return this.#tiles?.count ?? this.#mesh.count;
  }

  /** Releases all resources. Loses the WebGL context explicitly, because browsers have few and collect them late. */
  destroy(): void {
    if (this.#destroyed) return;
    this.#destroyed = true;
    const { gl } = this.#device;
    this.#nextFrame.cancel();
    this.#pending = [];
    this.#hidden = [];
    this.#hiding = [];
    this.#mesh.clear();
    this.#tiles?.destroy();
    this.#target.destroy();
    this.#app.destroy();
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    this.canvas.remove();
    for (const waiting of [this.#frameWaiters, this.#sortedWaiters, this.#replacementWaiters])
      for (const resolve of waiting.splice(0)) resolve();
  }

  /** Runs work. Ends drawing if it throws. */
  #try(work: () => void): void {
    try {
      work();
    } catch (error) {
      this.#fail(error as Error);
    }
  }

  /** Ends drawing: gives the context up, so that its owner decides what to do. */
  #fail(error: Error): void {
    if (this.#failure || this.#destroyed) return;
    this.#failure = new Error(isMemoryError(error) ? TOO_LITTLE_MEMORY : `Drawing failed: ${error.message}`);
    this.#pending = [];
    setTimeout(() => this.canvas.dispatchEvent(new Event("webglcontextlost")));
  }

  /** Ends drawing if the GPU refused memory. WebGL reports this only on request, and waits for the GPU. */
  #checkMemory(): void {
    const { gl } = this.#device;
    this.#memory = "checked";
    for (let n = 0, error = gl.getError(); error && n < 8; n++, error = gl.getError())
      if (error === gl.OUT_OF_MEMORY) this.#fail(new RangeError("GPU out of memory"));
  }

  /** True if drawing failed, false if only the context was lost. */
  get failed(): boolean {
    return this.#failure !== null;
  }

  /** Reason for a lost context. */
  get reason(): Error {
    return this.#failure ?? new Error("The graphics processor (GPU) failed repeatedly.");
  }

  /**
   * Returns the number of failures after the loss of this context and a number of failures before. It is infinite if
   * another context would be lost, too: a scene without tiles cannot be drawn with fewer Gaussians.
   */
  failuresAfter(failures: number): number {
    if (this.#failure && !this.#tiles && !this.#mesh.isEmpty) return Infinity;
    return performance.now() - this.#openedAt > STABLE_MS ? 1 : failures + 1;
  }

  /** Requests a frame. */
  touch(): void {
    if (this.#destroyed) return;
    this.#app.renderNextFrame = true;
    this.#drawnAt = performance.now();
    if (!this.#loopStopped) return;
    this.#loopStopped = false;
    (this.#app as unknown as FrameLoop).requestAnimationFrame();
  }

  /** Stops the frame loop if no frame was requested for a while. */
  #stopIdleLoop(): void {
    if (this.#headset.active) return;
    this.#app.renderNextFrame ||= this.#waitsForGpu;
    if (performance.now() - this.#drawnAt < IDLE_MS || this.#app.renderNextFrame) return;
    this.#nextFrame.cancel();
    this.#loopStopped = true;
    if (!this.#replaced) this.#mesh.releaseSpare();
  }

  /** Draws in the frames of the window that displays the canvas now. */
  onAdopted(): void {
    this.#nextFrame.follow();
  }

  /** Adapts to the size of the element. */
  resize(): void {
    if (this.#destroyed) return;
    const { canvas } = this,
      density = (canvas.ownerDocument.defaultView?.devicePixelRatio ?? 1) * cssZoomOf(canvas),
      ratio = Math.min(density, MAX_PIXEL_RATIO),
      fixed = this.#fixed,
      across = Math.max(canvas.clientWidth, 1),
      down = Math.max(canvas.clientHeight, 1),
      height = fixed ? fixed.height : Math.max(Math.round(down * ratio), 1),
      width = Math.max(Math.round(fixed ? (fixed.width ?? (height * across) / down) : across * ratio), 1),
      tangent = fixed ? height / 2 / fixed.focal : halfHeight(width, height);
    this.#pendingSize = { width, height, tangent };
    this.touch();
  }

  /**
   * Resizes the canvas, which clears it and waits for the GPU. Called right before a frame, after the last one is
   * drawn.
   */
  #applySize(): void {
    if (!this.#pendingSize) return;
    const { width, height, tangent } = this.#pendingSize;
    this.#pendingSize = null;
    this.#camera.camera!.fov = (2 * Math.atan(tangent) * 180) / Math.PI;
    this.#app.setCanvasResolution(RESOLUTION_FIXED, width, height);
    this.#target.resize(width, height);
    this.#memory = "changed";
  }

  background([red, green, blue]: readonly number[]): void {
    this.#camera.camera!.clearColor = new Color(red, green, blue, 1);
    this.touch();
  }

  /** Sets whether opacity decreases for Gaussians below the size of a pixel. */
  antialias(antialiased: boolean): void {
    this.#app.scene.gsplat.antiAlias = antialiased;
    this.#changed();
  }

  /**
   * Starts a new scene. `size` is its unit of length, world units, `expected` the number of its Gaussians, 0 if it is
   * unknown.
   */
  begin(size: number, expected = 0): void {
    this.#pending = [];
    this.#hidden = [];
    this.#hiding = [];
    this.#isArriving = true;
    this.#mesh.expected = expected;
    this.#tiles?.destroy();
    this.#tiles = null;
    this.#size = size;
    this.#mesh.clear();
  }

  /** Adds Gaussians. If `replaces` is true, they replace all others. */
  add(packed: Packed, replaces = false): void {
    if (this.#failure) return;
    if (replaces) return this.#try(() => this.#replace(packed));
    this.#pending.push(packed);
    this.#uploading ??= this.#upload()
      .catch((error: Error) => this.#fail(error))
      .finally(() => (this.#uploading = null));
  }

  #replace(packed: Packed): void {
    this.#pending = [];
    this.#hidden = [];
    this.#hiding = [];
    this.#mesh.replace(!this.#replaced);
    this.#replaced = this.#mesh.replacesDrawn;
    this.#mesh.add(packed);
    this.#mesh.show();
    this.#changed();
  }

  /** Returns the point of some Gaussians at a pixel, or next to it; null without one. */
  pick(parts: readonly Packed[], camera: Camera, x: number, y: number): readonly [number, number, number] | null {
    return pickPoint(parts, camera, x, y);
  }

  /** Hides Gaussians, by index in the order of arrival, and adds others in the same picture. */
  update(hidden: Int32Array, packed: Packed): void {
    this.#hidden.push(hidden);
    this.add(packed);
  }

  /** Announces that no more Gaussians will arrive, so that the last ones are drawn at once. */
  end(): void {
    this.#isArriving = false;
  }

  /** Uploads the pending Gaussians, all that have arrived at once, and draws them. */
  async #upload(): Promise<void> {
    while (this.#pending.length && !this.#destroyed) {
      while (this.#isArriving && performance.now() < this.#nextUpload && !this.#destroyed) await delay(POLL_MS);
      await this.#gpu.wait(() => this.#destroyed);
      this.#slices.begin();
      let added = 0;
      while (this.#pending.length && !this.#destroyed) {
        const packed = this.#pending.shift()!;
        added += packed.count;
        await this.#slices.after(this.#mesh.add(packed));
      }
      this.#uploadedAt = performance.now();
      if (this.#destroyed) return;
      this.#hideLater(this.#hidden.splice(0), added);
      this.#mesh.show();
      this.#hasSortFinished = this.#ready = false; // reports about the Gaussians before
      this.#changed();
    }
  }

  /**
   * Hides Gaussians in the frame that first draws the `added` ones. Hides them at once if there are none, since
   * PlayCanvas copies an equal number of Gaussians only now. Gaussians in memory that is not drawn yet are hidden
   * already.
   */
  #hideLater(all: readonly Int32Array[], added: number): void {
    const [manager] = this.#managers,
      version = manager?.world.lastWorldStateVersion ?? 0;
    if (!manager?.cpuSorter || this.#mesh.isGrowing || !added) {
      if (added) this.#hiding = [];
      for (const which of all) this.#mesh.hide(which);
    } else for (const which of all) this.#hiding.push({ which, version });
  }

  /** Hides Gaussians if this frame draws those that replace them. */
  #hideReplaced(): void {
    const sorted = Math.max(...this.#managers.map(({ cpuSorter }) => cpuSorter?.pendingSorted?.version ?? 0));
    while (this.#hiding.length && this.#hiding[0].version < sorted) this.#mesh.hide(this.#hiding.shift()!.which);
  }

  get #nextUpload(): number {
    const wanted = GPU_MULTIPLE * this.#gpu.busyMs;
    return this.#uploadedAt + Math.min(Math.max(wanted, MIN_INTERVAL_MS), MAX_INTERVAL_MS);
  }

  /** Replaces tiles of a scene with levels once the new ones are uploaded. */
  replaceTiles(removed: readonly number[], added: readonly Tile[]): void {
    this.#tiles ??= new TiledMeshes(
      this.#app,
      this.#gpu,
      () => this.#changedMemory(),
      (error) => this.#fail(error),
    );
    this.#replaced = true;
    this.#tiles.replaceTiles(removed, added);
  }

  /**
   * Applies gains of size and opacity, shape (count, 2), by order of arrival or ascending tile. A size of 0 hides a
   * Gaussian; later Gaussians keep gain 1. Resolves after the upload.
   */
  async setGains(gains: Float32Array | null): Promise<void> {
    if (this.#tiles) {
      this.#replaced = true;
      return this.#tiles.setGains(gains);
    }
    this.#try(() => this.#mesh.setGains(gains));
    this.#changed();
  }

  /** Current camera, world units. */
  get camera(): Camera {
    const { width, height } = this.canvas,
      fixed = this.#fixed;
    if (fixed)
      return { viewmat: fixed.viewmat, focal: (fixed.focal * height) / fixed.height, width, height, margin: 0 };
    if (this.#headset.active) return cameraFromPose(this.#headset.pose, this.#size, width / 2, height);
    return cameraFromPose(this.orbit.pose(), this.#size, width, height);
  }

  /**
   * Uses a camera of `splatwire`; null returns to the orbit camera. Throws `RangeError` if its picture is too large for
   * the GPU.
   */
  fix(camera: FixedCamera | null): void {
    const size = Math.max(camera?.height ?? 0, camera?.width ?? 0),
      most = this.#device.maxTextureSize;
    if (size > most) throw new RangeError(`a picture of this device has at most ${most} pixels per side, not ${size}`);
    this.#fixed = camera;
    this.resize();
    this.#changed(); // view-dependent colours are otherwise updated only after a movement
  }

  /** Camera of `splatwire` in use, which has its own picture size; null if the orbit camera is used. */
  get fixed(): FixedCamera | null {
    return this.#fixed;
  }

  /** Shows the scene in a headset, instead of on the page, until the session ends. Throws if it cannot start. */
  enterHeadset(): Promise<void> {
    return this.#headset.start();
  }

  #onHeadset(): void {
    if (this.#destroyed) return;
    this.#target.used = !this.#headset.active;
    this.resize();
    this.#changed();
  }

  /** Resolves in the task of the next frame, while the canvas can be read. */
  async frame(): Promise<void> {
    await this.#uploading;
    this.touch();
    if (!this.#destroyed) await new Promise<void>((resolve) => this.#frameWaiters.push(resolve));
  }

  /**
   * Resolves in the task of the next frame with sorted depths that shows everything added, at the latest after
   * `SORT_MS`.
   */
  sorted(): Promise<void> {
    if (!this.#uploading) this.touch();
    return new Promise((resolve) => {
      this.#sortedWaiters.push(resolve);
      setTimeout(resolve, SORT_MS);
    });
  }

  /** Resolves once the Gaussians that replaced others are sorted, at the latest after `SORT_MS`. */
  replacementSorted(): Promise<void> {
    if (!this.#replaced) return Promise.resolve();
    this.touch();
    return new Promise((resolve) => {
      this.#replacementWaiters.push(resolve);
      setTimeout(resolve, SORT_MS);
    });
  }

  /** True if a depth sort is pending or running. */
  get isSorting(): boolean {
    if (this.#destroyed) return false;
    return !this.#ready || this.#moved || this.#replaced || this.#isWorkerSorting;
  }

  get #isWorkerSorting(): boolean {
    return this.#managers.some(({ cpuSorter }) => cpuSorter?.jobsInFlight || cpuSorter?.pendingSorted);
  }

  get #managers(): readonly Manager[] {
    const { gsplatDirector } = this.#app.renderer as unknown as SorterInternals,
      layers = [...gsplatDirector.camerasMap.values()].flatMap(({ layersMap }) => [...layersMap.values()]);
    return layers.flatMap(({ gsplatManager }) => gsplatManager ?? []);
  }

  /** Handles PlayCanvas's report whether everything added is sorted. */
  #onSortReport(ready: boolean): void {
    this.#ready = ready;
    if (!ready || !this.#replaced || this.#tiles?.settled === false) return;
    this.#replaced = false;
    this.#tiles?.noteSorted();
    if (this.#tiles) this.#changed();
    else this.touch(); // replaced Gaussians were copied while sorting, so no second copy is needed
    for (const resolve of this.#replacementWaiters.splice(0)) resolve();
  }

  #changed(): void {
    if (!this.#replaced) this.#mesh.resort();
    this.#tiles?.resort();
    this.#changedMemory();
  }

  #changedMemory(): void {
    this.#memory = "changed";
    this.touch();
  }

  #beforeFrame(): void {
    const { idle } = this.#gpu,
      { active } = this.#headset;
    if ((idle || active) && this.#memory === "drawn") this.#checkMemory();
    if (!active) this.#prepareFrame(idle); // a headset places the camera and sets the pace
    if (this.#hiding.length) this.#hideReplaced();
    this.watcher?.(this.camera);
  }

  /** Places the camera, and postpones the frame unless the GPU is idle. */
  #prepareFrame(idle: boolean): void {
    if (!this.#fixed) {
      const { position, rotation } = this.orbit.pose();
      this.#camera.setPosition(position.x, position.y, position.z);
      this.#camera.setRotation(rotation.x, rotation.y, rotation.z, rotation.w);
    } else placeFixed(this.#camera, this.#fixed.viewmat, this.#size);
    this.#sortWhenAtRest();
    this.#waitsForGpu = this.#app.renderNextFrame && !idle;
    if (this.#waitsForGpu) this.#app.renderNextFrame = false;
    else if (this.#app.renderNextFrame) this.#applySize();
  }

  #sortWhenAtRest(): void {
    const pose = this.#camera.getWorldTransform();
    if (!pose.equals(this.#pose)) {
      this.#pose.copy(pose);
      this.#moved = true;
    } else if (this.#moved && !this.#replaced && !this.#isWorkerSorting) {
      // the sorter ignores requests while it works, and #changed() requests nothing while Gaussians are replaced
      this.#moved = false;
      this.#changed();
    }
  }

  #afterFrame(): void {
    this.#drawnAt = performance.now();
    if (this.#device.takeSkipped()) {
      setTimeout(() => !this.#destroyed && this.#changed(), POLL_MS);
      return;
    }
    this.#target.show();
    if (this.#memory === "changed") this.#memory = "drawn";
    this.#gpu.mark();
    for (const resolve of this.#frameWaiters.splice(0)) resolve();
    if (this.#hasSortFinished) this.shows ||= this.count > 0;
    else if (!this.shows || this.isSorting) return;
    this.#hasSortFinished = false;
    if (!this.#uploading) for (const resolve of this.#sortedWaiters.splice(0)) resolve();
  }
}

/** Returns true for errors of an allocation. Firefox throws errors of another type, or a string. */
function isMemoryError(error: unknown): boolean {
  return error instanceof RangeError || /out of memory|allocat/i.test(String(error));
}

function placeFixed(camera: Entity, [x, y, z]: readonly (readonly number[])[], size: number): void {
  const eye = [0, 1, 2].map((a) => -(x[a] * x[3] + y[a] * y[3] + z[a] * z[3]) / size);
  const axes = new Mat4().set([x[0], x[1], x[2], 0, -y[0], -y[1], -y[2], 0, -z[0], -z[1], -z[2], 0, 0, 0, 0, 1]);
  camera.setPosition(eye[0], eye[1], eye[2]);
  camera.setRotation(new Quat().setFromMat4(axes));
}
