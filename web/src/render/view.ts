// The drawing: a canvas, a camera and Gaussians, drawn when something changed and not otherwise.

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
  WebglGraphicsDevice,
} from "playcanvas";

import type { Camera, FixedCamera } from "../model/camera.ts";
import { Card } from "./card.ts";
import { cameraOf, tangentOf } from "./lens.ts";
import type { Orbit } from "./orbit.ts";
import type { Packed, Tile } from "./packed.ts";
import { Precise } from "./precise.ts";
import { COMMON, CORNER, FRAGMENT } from "./shaders.ts";
import { TiledGaussians } from "./tiled.ts";
import { WholeGaussians } from "./whole.ts";

/** Depths are sorted in a worker; a picture that has waited for it so long is taken as it is. */
const SORT_MS = 5000;
/** So long after the last picture nothing can change unasked: frames end until somebody asks for one. */
const IDLE_MS = SORT_MS;

/** Pixels of a picture per CSS pixel, at most. */
const MOST_DENSITY = 2;

/** How PlayCanvas comes to its next frame. */
interface Loop {
  readonly frameRequestId: number;
  requestAnimationFrame(): void;
}

/** Where PlayCanvas keeps who sorts, of each layer of each camera. */
interface Sorting {
  readonly gsplatDirector: { readonly camerasMap: Map<unknown, { readonly layersMap: Map<unknown, Layer> }> };
}
interface Layer {
  readonly gsplatManager: { readonly cpuSorter: { jobsInFlight: number; pendingSorted: unknown } | null } | null;
}

export class View {
  readonly #app: AppBase;
  readonly #camera: Entity;
  readonly #precise: Precise;
  readonly #card: Card;
  /** Whether a frame waits until the card has drawn the one before: it then shows what is there by then. */
  #late = false;
  readonly #whole: WholeGaussians;
  /** Of a scene with levels, in place of those. */
  #tiles: TiledGaussians | null = null;
  #size = 1;
  #fixed: FixedCamera | null = null;
  /** The size of the next picture and half its height at distance 1, if it is another one than before. */
  #wanted: { readonly width: number; readonly height: number; readonly tangent: number } | null = null;
  #frame: (() => void)[] = [];
  #sorted: (() => void)[] = [];
  #steady: (() => void)[] = [];
  #isSorted = false;
  readonly #pose = new Mat4();
  /** Whether the camera moved since it last rested: the engine does not sort for who moves while it sorts. */
  #moved = false;
  /**
   * Whether Gaussians took the place of others and are not sorted by depth yet: until then those stay on the screen.
   */
  #replaced = false;
  /** Whether all that was added is sorted, as of the last frame. */
  #ready = false;
  /** Whether Gaussians are on the screen. */
  shows = false;
  #destroyed = false;
  #drawnAt = 0;
  #asleep = false;
  /** Told of the camera of each frame, world units. */
  watcher: ((camera: Camera) => void) | null = null;

  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly orbit: Orbit,
  ) {
    const device = new WebglGraphicsDevice(canvas, {
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
      farClip: 2000,
      toneMapping: TONEMAP_NONE,
      gammaCorrection: GAMMA_SRGB,
    });
    this.#card = new Card(device);
    this.#precise = new Precise(device, this.#camera.camera!);
    this.#app.root.addChild(this.#camera);
    this.#whole = new WholeGaussians(this.#app);
    this.#app.on("update", () => this.#beforeFrame());
    this.#app.systems.gsplat!.on("frame:request", () => this.touch());
    this.#app.scene.on("gsplat:sorted", () => {
      this.#isSorted = true;
      if (this.#moved) this.touch();
    });
    this.#app.systems.gsplat!.on("frame:ready", (_camera: unknown, _layer: unknown, ready: boolean) =>
      this.#isReady(ready),
    );
    this.#app.on("postrender", () => this.#afterFrame());
    this.#app.on("frameend", () => this.#rest());
    this.resize();
    this.#fit();
    this.#app.start();
  }

  get count(): number {
    return this.#tiles?.count ?? this.#whole.count;
  }

  /** Gives everything back: the context, too, for a browser has few and waits long before it collects one. */
  destroy(): void {
    if (this.#destroyed) return;
    this.#destroyed = true;
    const { gl } = this.#app.graphicsDevice as WebglGraphicsDevice;
    this.#whole.clear();
    this.#tiles?.destroy();
    this.#precise.destroy();
    this.#app.destroy();
    gl.getExtension("WEBGL_lose_context")?.loseContext();
    this.canvas.remove();
    for (const waiting of [this.#frame, this.#sorted, this.#steady]) for (const resolve of waiting.splice(0)) resolve();
  }

  /** Draws a frame soon. */
  touch(): void {
    if (this.#destroyed) return;
    this.#app.renderNextFrame = true;
    this.#drawnAt = performance.now();
    if (!this.#asleep) return;
    this.#asleep = false;
    (this.#app as unknown as Loop).requestAnimationFrame();
  }

  /** Ends frames where nobody has asked for one in a while. */
  #rest(): void {
    const loop = this.#app as unknown as Loop;
    this.#app.renderNextFrame ||= this.#late;
    if (performance.now() - this.#drawnAt < IDLE_MS || this.#app.renderNextFrame) return;
    cancelAnimationFrame(loop.frameRequestId);
    this.#asleep = true;
    if (!this.#replaced) this.#whole.rest();
  }

  /** Takes the size of the element on the page. */
  resize(): void {
    if (this.#destroyed) return;
    const { canvas } = this,
      ratio = Math.min(canvas.ownerDocument.defaultView?.devicePixelRatio ?? 1, MOST_DENSITY),
      fixed = this.#fixed,
      across = Math.max(canvas.clientWidth, 1),
      down = Math.max(canvas.clientHeight, 1),
      height = fixed ? fixed.height : Math.max(Math.round(down * ratio), 1),
      width = Math.max(Math.round(fixed ? (fixed.width ?? (height * across) / down) : across * ratio), 1),
      tangent = fixed ? height / 2 / fixed.focal : tangentOf(width, height);
    this.#wanted = { width, height, tangent };
    this.touch();
  }

  /**
   * Gives the canvas its size, which empties it and waits for the card: right before a frame, and not while the one
   * before is drawn, which until then is shown in another size.
   */
  #fit(): void {
    if (!this.#wanted) return;
    const { width, height, tangent } = this.#wanted;
    this.#wanted = null;
    this.#camera.camera!.fov = (2 * Math.atan(tangent) * 180) / Math.PI;
    this.#app.setCanvasResolution(RESOLUTION_FIXED, width, height);
    this.#precise.resize(width, height);
  }

  background([red, green, blue]: readonly number[]): void {
    this.#camera.camera!.clearColor = new Color(red, green, blue, 1);
    this.touch();
  }

  /** Has Gaussians lose opacity as they are widened to a pixel, or not. */
  antialias(antialiased: boolean): void {
    this.#app.scene.gsplat.antiAlias = antialiased;
    this.#changed();
  }

  /** Begins anew with Gaussians of a scene of this size (world units), which lengths are in units of. */
  begin(size: number): void {
    this.#tiles?.destroy();
    this.#tiles = null;
    this.#size = size;
    this.#whole.clear();
  }

  /** Takes Gaussians in addition to those that are there, or instead of them. */
  add(packed: Packed, instead = false): void {
    if (instead) {
      this.#whole.replace(!this.#replaced);
      this.#replaced = this.#whole.any;
    }
    this.#whole.add(packed);
    this.#changed();
  }

  /** Has tiles of a scene with levels take the place of others, as soon as they are uploaded. */
  recut(gone: readonly number[], come: readonly Tile[]): void {
    this.#tiles ??= new TiledGaussians(this.#app, this.#card, () => this.touch());
    this.#replaced = true;
    this.#tiles.recut(gone, come);
  }

  /**
   * Gains of size and opacity in turn, by order of arrival or ascending tile; size 0 hides, and those that came later
   * are shown as they are. Resolves when they are on the card.
   */
  async setGains(gains: Float32Array | null): Promise<void> {
    if (this.#tiles) {
      this.#replaced = true;
      return this.#tiles.setGains(gains);
    }
    this.#whole.setGains(gains);
    this.#changed();
  }

  /** Where it looks from, world units. */
  get camera(): Camera {
    const { width, height } = this.canvas,
      fixed = this.#fixed;
    if (fixed)
      return { viewmat: fixed.viewmat, focal: (fixed.focal * height) / fixed.height, width, height, margin: 0 };
    return cameraOf(this.orbit.pose(), this.#size, width, height);
  }

  /** Looks through a camera of `splatwire`; null gives it back to the hand. */
  fix(camera: FixedCamera | null): void {
    this.#fixed = camera;
    this.resize();
    this.#changed(); // colours are those of the camera before until it moves again
  }

  /** True while a camera of `splatwire` is looked through, which has a size of its own. */
  get isFixed(): boolean {
    return this.#fixed !== null;
  }

  /** Resolves in the task of the next frame, in which the canvas can be read. */
  frame(): Promise<void> {
    this.touch();
    if (this.#destroyed) return Promise.resolve();
    return new Promise((resolve) => this.#frame.push(resolve));
  }

  /** Resolves in the task of the next frame whose depths were sorted anew, or do not have to be. */
  sorted(): Promise<void> {
    this.touch();
    return new Promise((resolve) => {
      this.#sorted.push(resolve);
      setTimeout(resolve, SORT_MS);
    });
  }

  /** Resolves when what was added last is what is drawn. */
  steady(): Promise<void> {
    if (!this.#replaced) return Promise.resolve();
    this.touch();
    return new Promise((resolve) => {
      this.#steady.push(resolve);
      setTimeout(resolve, SORT_MS);
    });
  }

  /** Whether depths are sorted, or have to be. */
  get #sorts(): boolean {
    if (!this.#ready || this.#moved || this.#replaced) return true;
    const { gsplatDirector } = this.#app.renderer as unknown as Sorting;
    return [...gsplatDirector.camerasMap.values()].some(({ layersMap }) =>
      [...layersMap.values()].some(
        ({ gsplatManager: manager }) => manager?.cpuSorter?.jobsInFlight || manager?.cpuSorter?.pendingSorted,
      ),
    );
  }

  /** Told in each frame whether all that was added is sorted. */
  #isReady(ready: boolean): void {
    this.#ready = ready;
    if (!ready || !this.#replaced || this.#tiles?.settled === false) return;
    this.#replaced = false;
    this.#tiles?.sorted();
    if (this.#tiles) this.#changed();
    else this.touch(); // what took turns was copied as it was sorted: once more would take as long again
    for (const resolve of this.#steady.splice(0)) resolve();
  }

  #changed(): void {
    if (!this.#replaced) this.#whole.again();
    this.#tiles?.again();
    this.touch();
  }

  #beforeFrame(): void {
    if (!this.#fixed) {
      const { position, rotation } = this.orbit.pose();
      this.#camera.setPosition(position.x, position.y, position.z);
      this.#camera.setRotation(rotation.x, rotation.y, rotation.z, rotation.w);
    } else placeFixed(this.#camera, this.#fixed.viewmat, this.#size);
    this.#sortAtRest();
    this.#late = this.#app.renderNextFrame && !this.#card.idle;
    if (this.#late) this.#app.renderNextFrame = false;
    else if (this.#app.renderNextFrame) this.#fit();
    this.watcher?.(this.camera);
  }

  #sortAtRest(): void {
    const pose = this.#camera.getWorldTransform();
    if (!pose.equals(this.#pose)) {
      this.#pose.copy(pose);
      this.#moved = true;
    } else if (this.#moved && this.#isSorted) {
      this.#moved = false;
      this.#changed();
    }
  }

  #afterFrame(): void {
    this.#drawnAt = performance.now();
    this.#precise.show();
    this.#card.mark();
    for (const resolve of this.#frame.splice(0)) resolve();
    if (this.#isSorted) this.shows ||= this.count > 0;
    else if (!this.shows || this.#sorts) return;
    this.#isSorted = false;
    for (const resolve of this.#sorted.splice(0)) resolve();
  }
}

function placeFixed(camera: Entity, [x, y, z]: readonly (readonly number[])[], size: number): void {
  const eye = [0, 1, 2].map((a) => -(x[a] * x[3] + y[a] * y[3] + z[a] * z[3]) / size);
  const axes = new Mat4().set([x[0], x[1], x[2], 0, -y[0], -y[1], -y[2], 0, -z[0], -z[1], -z[2], 0, 0, 0, 0, 1]);
  camera.setPosition(eye[0], eye[1], eye[2]);
  camera.setRotation(new Quat().setFromMat4(axes));
}
