// What is on the screen: the first pictures painted at once, and the scene as soon as the code that draws it is there.

import { Vec3 } from "playcanvas";

import type { Ball, Viewpoint } from "../codec/decoder.ts";
import type { Camera } from "../model/camera.ts";
import { acquire, giveBack, type Holder, offer } from "../render/contexts.ts";
import type { Core } from "../render/core.ts";
import { coreOf, frameScene } from "../render/framing.ts";
import { Hands } from "../render/hands.ts";
import { cameraOf, tangentOf } from "../render/lens.ts";
import { loadView } from "../render/load.ts";
import { Orbit, type Place } from "../render/orbit.ts";
import type { Packed, Tile } from "../render/packed.ts";
import { paint } from "../render/painter.ts";
import { pointAt } from "../render/pick.ts";
import { Space } from "../render/space.ts";
import type { View } from "../render/view.ts";
import { pause } from "../turns.ts";

/**
 * Setting up WebGL holds up the page, for a second where the processor does it: not before so much has come, or so long
 * has passed.
 */
const ENOUGH_GAUSSIANS = 50_000,
  ENOUGH_MS = 3000;
/** A page that is not visible draws no frames: what should come after one comes then all the same. */
const PATIENCE_MS = 100;
/** A context that the browser took is asked for again after a while. */
const LOST_MS = 1000;

/** How long a hint is shown, milliseconds. */
const HINT_MS = 2000;

/** Gaussians in front of a background. */
export interface Shown {
  readonly packed: Packed;
  readonly background: readonly number[];
}

export class Stage implements Holder {
  /** What hands are on; holds the canvases. */
  readonly surface = document.createElement("div");
  /** Where the first pictures are painted, above the other one until that has something to show. */
  readonly first = document.createElement("canvas");
  readonly orbit = new Orbit(
    () => this.touch(),
    () => this.#room(),
    (at) => this.#seen(at),
  );
  readonly hands = new Hands(this.surface, this.orbit, (text) => this.#showHint(text));
  readonly #hint = document.createElement("p");
  #hinting = 0;
  view: View | null = null;
  inSight = true;
  /** Where a clip goes, world units, if the stream says it. */
  extent: Ball | null = null;
  /** Told of the camera of each picture. */
  watcher: ((camera: Camera) => void) | null = null;
  #parts: Packed[] = [];
  /** What they are of, of a scene with levels. */
  readonly #tiles = new Map<number, Packed>();
  #size = 1;
  #count = 0;
  /** Middle and size of a scene, as far as they are known before its Gaussians. */
  #facing: { readonly middle: readonly number[]; readonly size: number } | null = null;
  /** How many Gaussians there were when the camera was pointed at them. */
  #framed = 0;
  /** Where the camera may be, as of so many Gaussians. */
  #space: Space | null = null;
  #spaced = 0;
  #background: readonly number[] = [0, 0, 0];
  #antialiased = false;
  #waiting: ((view: View) => void)[] = [];
  #painting: Promise<void> | null = null;
  #stale = false;
  #shown: (() => void)[] = [];
  #opening = false;
  #destroyed = false;
  #enough: () => void = () => undefined;
  readonly #isEnough = new Promise<void>((resolve) => (this.#enough = resolve));

  /** `opened` is told of each view, `failed` why there is none. */
  constructor(
    readonly opened: (view: View) => void,
    readonly failed: (error: Error) => void,
    readonly title: string,
  ) {
    this.surface.className = "scene";
    this.surface.tabIndex = 0;
    this.surface.setAttribute("role", "application");
    this.surface.setAttribute("aria-roledescription", "three-dimensional scene");
    this.surface.setAttribute("aria-label", `${title}: arrow keys turn it, plus and minus zoom, Home goes back`);
    this.first.className = "first";
    describe(this.first, title);
    this.#hint.className = "hint";
    this.surface.append(this.first, this.#hint);
  }

  /** Leaves the wheel alone and one finger to the page, or takes them for the scene. */
  cooperate(cooperative: boolean): void {
    this.hands.cooperative = cooperative;
    this.surface.classList.toggle("cooperative", cooperative);
  }

  #showHint(text: string): void {
    this.#hint.textContent = text;
    this.#hint.classList.add("shown");
    clearTimeout(this.#hinting);
    this.#hinting = window.setTimeout(() => this.#hint.classList.remove("shown"), HINT_MS);
  }

  /** Where there is room for the camera; null as long as there is nothing else. */
  #room(): Space | null {
    if (this.#count && this.#count >= 1.5 * this.#spaced) {
      this.#space = new Space(coreOf(this.#parts), this.#parts);
      this.#spaced = this.#count;
    }
    return this.#space;
  }

  /** What is at a place of the window, or next to it. */
  #seen(at: Place | null): Vec3 | null {
    const { clientWidth: width, clientHeight: height } = this.surface,
      camera = cameraOf(this.orbit.pose(), 1, width, height),
      { x, y } = at ?? { x: width / 2, y: height / 2 },
      point = pointAt(this.#parts, camera, x, y);
    return point && new Vec3(...point);
  }

  /** Loads what draws and begins to draw, if it may. */
  async open(): Promise<void> {
    if (this.#opening || this.view || this.#destroyed) return;
    this.#opening = true;
    try {
      await this.#open();
    } catch (error) {
      giveBack(this);
      this.failed(error as Error);
    } finally {
      this.#opening = false;
    }
  }

  async #open(): Promise<void> {
    if (this.#count) await this.shown();
    const Drawing = await loadView().catch(() =>
      Promise.reject(new Error("The part of this page that draws could not be loaded; load the page again.")),
    );
    setTimeout(this.#enough, ENOUGH_MS);
    await this.#isEnough;
    if (this.#count) await this.shown();
    if (this.#destroyed || !this.inSight || !acquire(this)) return;
    const canvas = document.createElement("canvas");
    describe(canvas, this.title);
    this.surface.prepend(canvas);
    try {
      this.view = new Drawing(canvas, this.orbit);
    } catch (error) {
      canvas.remove();
      throw new Error(`This browser cannot draw: it has no WebGL 2 (${(error as Error).message}).`);
    }
    const view = this.view;
    canvas.addEventListener("webglcontextlost", () => this.#contextLost(view));
    view.watcher = (camera) => this.#watched(camera);
    view.background(this.#background);
    view.antialias(this.#antialiased);
    view.begin(this.#size);
    if (this.#tiles.size)
      view.recut(
        [],
        Array.from(this.#tiles, ([tile, packed]) => ({ tile, packed })),
      );
    else for (const part of this.#parts) view.add(part);
    do
      await view.sorted(); // not for ever: what is painted stays until there is something else to see
    while (this.view === view && this.#count && !view.shows);
    if (this.view !== view) return;
    for (const work of this.#waiting.splice(0)) work(view);
    this.opened(view);
    this.first.classList.remove("shown");
    for (const resolve of this.#shown.splice(0)) resolve();
  }

  /** The browser took the context away: the picture is painted until there is another one. */
  #contextLost(view: View): void {
    if (this.view !== view) return;
    this.release();
    giveBack(this);
    setTimeout(() => void this.open(), LOST_MS);
  }

  /** Gives the context back; the picture is painted. */
  release(): void {
    const view = this.view;
    this.view = null;
    view?.destroy();
    this.touch();
  }

  offered(): void {
    void this.open();
  }

  /** Whether somebody can see it: a context is for those. */
  sight(inSight: boolean): void {
    if (this.inSight === inSight) return;
    this.inSight = inSight;
    if (!inSight) return offer();
    this.touch();
    void this.open();
  }

  /** Gives everything back. */
  destroy(): void {
    this.#destroyed = true;
    clearTimeout(this.#hinting);
    this.#parts = [];
    this.#count = 0;
    this.release();
    giveBack(this);
    this.#enough();
    for (const resolve of this.#shown.splice(0)) resolve();
  }

  /** Does something with the view: now, or once there is one. */
  draw(work: (view: View) => void): void {
    if (this.view) work(this.view);
    else this.#waiting.push(work);
  }

  /** Shows a preview, if nothing is shown yet; resolves when it is on the screen. */
  async preview({ packed, background }: Shown): Promise<void> {
    if (this.#count) return;
    this.background(background);
    this.add(packed);
    await this.shown();
  }

  /** Has Gaussians lose opacity as they are widened to a pixel, or not. */
  antialias(antialiased: boolean): void {
    this.#antialiased = antialiased;
    this.view?.antialias(antialiased);
  }

  background(colour: readonly number[]): void {
    this.#background = colour;
    this.view?.background(colour);
  }

  /** Begins where the page or the stream says, unless somebody moved before; who says it first is heard. */
  start({ eye, target, up }: Viewpoint): void {
    if (this.orbit.touched || this.orbit.placed) return;
    const scaled = (point: readonly number[]): Vec3 => new Vec3(...point.map((value) => value / this.#size));
    this.orbit.place(scaled(eye), scaled(target), new Vec3(...up));
    this.touch();
  }

  /** Looks at a scene of which only the middle and the size are known, unless somebody moved before. */
  face(middle: readonly number[], size: number): void {
    this.#facing = { middle, size };
    if (this.orbit.touched || this.orbit.placed || this.#framed || !this.#hasRoom) return;
    const lens = this.#lens(),
      radius = size / this.#size,
      half = Math.atan(Math.min(lens.across, lens.down));
    this.orbit.begin(
      middle.map((value) => value / this.#size),
      radius / Math.sin(half),
    );
    this.touch();
  }

  /** True if the element takes room on the page; it does not while it is hidden or has no height yet. */
  get #hasRoom(): boolean {
    return this.surface.clientWidth > 0 && this.surface.clientHeight > 0;
  }

  /** Half of what the window shows at distance 1. */
  #lens(): { across: number; down: number } {
    const { clientWidth: width, clientHeight: height } = this.surface,
      down = tangentOf(width, height);
    return { across: (down * width) / Math.max(height, 1), down };
  }

  /** Where it goes, in units of the view: around what is there now, unless the stream says it. */
  #extent(core: Core): Ball {
    if (!this.extent) return core;
    const { middle, radius } = this.extent;
    return { middle: middle.map((value) => value / this.#size), radius: radius / this.#size };
  }

  /** Has what is there fit the window, unless somebody said where to look from, or moved. */
  #frame(): void {
    if (this.orbit.touched || this.orbit.placed || !this.#count) return;
    const { across, down } = this.#lens(),
      core = coreOf(this.#parts);
    if (!this.#hasRoom) return;
    frameScene(this.orbit, core, new Space(core, this.#parts), across, down, this.#extent(core));
    this.#framed = this.#count;
  }

  /** Hears that no more will come. */
  settle(): void {
    if (this.#count > this.#framed) this.#frame();
    this.touch();
  }

  /** What is up in the scene, as the page or the stream says. */
  upIs(up: string): void {
    if (this.orbit.placed) return;
    this.orbit.upIs(up);
    this.#frame();
    this.touch();
  }

  /** Hands on the camera of a picture; one without pixels asks for nothing. A fixed camera brings its own pixels. */
  #watched(camera: Camera): void {
    if (this.#hasRoom || this.view?.isFixed) this.watcher?.(camera);
  }

  /** Hands on the camera as it is. */
  watch(): void {
    this.#watched(this.camera);
  }

  /** Where it is seen from, world units. */
  get camera(): Camera {
    return (
      this.view?.camera ?? cameraOf(this.orbit.pose(), this.#size, this.surface.clientWidth, this.surface.clientHeight)
    );
  }

  /** Begins anew with Gaussians of a scene of this size (world units); the camera stays where it is. */
  begin(size: number): void {
    this.orbit.rescale(this.#size / size);
    this.#parts = [];
    this.#tiles.clear();
    this.#size = size;
    this.#count = this.#framed = this.#spaced = 0;
    this.#space = null;
    this.view?.begin(size);
  }

  /** Has tiles take the place of others. */
  recut(gone: readonly number[], come: readonly Tile[]): void {
    for (const tile of gone) this.#tiles.delete(tile);
    for (const { tile, packed } of come) this.#tiles.set(tile, packed);
    this.#parts = [...this.#tiles.values()];
    this.#count = this.#parts.reduce((sum, { count }) => sum + count, 0);
    if (this.#count >= 1.5 * this.#framed) this.#frame();
    this.view?.recut(gone, come);
    if (this.#count > ENOUGH_GAUSSIANS) this.enough();
    this.touch();
  }

  /** Takes Gaussians in addition to those that are there, or instead of them. */
  add(packed: Packed, instead = false): void {
    this.#parts = instead ? [packed] : [...this.#parts, packed];
    this.#count = instead ? packed.count : this.#count + packed.count;
    if (this.#count >= 1.5 * this.#framed) this.#frame();
    this.view?.add(packed, instead);
    if (this.#count > ENOUGH_GAUSSIANS) this.enough();
    this.touch();
  }

  get count(): number {
    return this.#count;
  }

  /** Says that so much is there that it is time for WebGL. */
  enough(): void {
    this.#enough();
  }

  /** Resolves when what was added is on the screen. */
  shown(): Promise<void> {
    if (this.view) return this.view.sorted();
    this.touch();
    return new Promise((resolve) => this.#shown.push(resolve));
  }

  /** Follows the size of the element. One that takes no room keeps the size and the picture that it had. */
  resize(): void {
    if (!this.#hasRoom) return;
    if (this.#facing) this.face(this.#facing.middle, this.#facing.size);
    this.#frame();
    this.view?.resize();
    this.touch();
  }

  touch(): void {
    this.#stale = true;
    if (this.view) this.view.touch();
    else if (this.#count && this.inSight) this.#painting ??= this.#paint();
  }

  /** Paints as long as something changes and there is no view. */
  async #paint(): Promise<void> {
    this.first.classList.add("shown");
    await null; // what else changes in this task is painted with it
    while (this.#stale && !this.view && !this.#destroyed) {
      const shown = this.#shown.splice(0),
        began = performance.now();
      this.#stale = false;
      this.#watched(this.camera);
      const antialiased = this.#antialiased;
      paint(this.first, { parts: this.#parts, background: this.#background, pose: this.orbit.pose(), antialiased });
      const took = performance.now() - began;
      await painted();
      for (const resolve of shown) resolve();
      await Promise.race([this.#isEnough, pause(4 * took)]); // most of the time is left to the packets
    }
    this.#painting = null;
  }
}

/** A canvas is a picture, for those who cannot see it, too. */
function describe(canvas: HTMLCanvasElement, title: string): void {
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Picture of ${title}`);
}

/** Resolves when what was painted is on the screen. */
function painted(): Promise<void> {
  return new Promise((resolve) => {
    requestAnimationFrame(() => setTimeout(resolve));
    setTimeout(resolve, PATIENCE_MS);
  });
}
