// What is on the screen: the first pictures painted at once, and the scene as soon as the code that draws it is there.

import { Vec3 } from "playcanvas";

import type { Viewpoint } from "../codec/decoder.ts";
import type { Camera } from "../model/camera.ts";
import { frameSplats } from "../render/framing.ts";
import { loadView } from "../render/load.ts";
import { cameraOf, Orbit } from "../render/orbit.ts";
import type { Packed } from "../render/packed.ts";
import { paint } from "../render/painter.ts";
import type { View } from "../render/view.ts";

/**
 * Setting up WebGL holds up the page, for a second where the processor does it: not before so much has come, or so long
 * has passed.
 */
const ENOUGH_GAUSSIANS = 50_000,
  ENOUGH_MS = 3000;
/** A page that is not visible draws no frames: what should come after one comes then all the same. */
const PATIENCE_MS = 100;

/** Gaussians in front of a background. */
export interface Shown {
  readonly packed: Packed;
  readonly background: readonly number[];
}

export class Stage {
  readonly canvas = document.createElement("canvas");
  /** Where the first pictures are painted, above the other one until that has something to show. */
  readonly first = document.createElement("canvas");
  readonly orbit = new Orbit(this.canvas, () => this.touch());
  view: View | null = null;
  /** Told of the camera of each picture. */
  watcher: ((camera: Camera) => void) | null = null;
  #parts: Packed[] = [];
  #size = 1;
  #count = 0;
  /** How many Gaussians there were when the camera was pointed at them. */
  #framed = 0;
  #background: readonly number[] = [0, 0, 0];
  #waiting: ((view: View) => void)[] = [];
  #painting: Promise<void> | null = null;
  #stale = false;
  #shown: (() => void)[] = [];
  #enough: () => void = () => undefined;
  readonly #isEnough = new Promise<void>((resolve) => (this.#enough = resolve));

  constructor() {
    this.canvas.tabIndex = 0;
    this.first.className = "first";
  }

  /** Loads what draws and begins to draw. Throws where that cannot be. */
  async open(): Promise<void> {
    if (this.#count) await this.shown();
    const Drawing = await loadView().catch(() =>
      Promise.reject(new Error("The part of this page that draws could not be loaded; load the page again.")),
    );
    setTimeout(this.#enough, ENOUGH_MS);
    await this.#isEnough;
    if (this.#count) await this.shown();
    try {
      this.view = new Drawing(this.canvas, this.orbit);
    } catch (error) {
      throw new Error(`This browser cannot draw: it has no WebGL 2 (${(error as Error).message}).`);
    }
    this.view.watcher = (camera) => this.watcher?.(camera);
    this.view.background(this.#background);
    this.view.begin(this.#size);
    for (const part of this.#parts) this.view.add(part);
    for (const work of this.#waiting.splice(0)) work(this.view);
    await this.view.sorted();
    this.first.classList.remove("shown");
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
    if (this.orbit.touched || this.orbit.placed || this.#framed) return;
    this.orbit.frame(
      middle.map((value) => value / this.#size),
      size / this.#size,
    );
    this.touch();
  }

  /** Where it is seen from, world units. */
  get camera(): Camera {
    return (
      this.view?.camera ?? cameraOf(this.orbit.pose(), this.#size, this.canvas.clientWidth, this.canvas.clientHeight)
    );
  }

  /** Begins anew with Gaussians of a scene of this size (world units); the camera stays where it is. */
  begin(size: number): void {
    this.orbit.rescale(this.#size / size);
    this.#parts = [];
    this.#size = size;
    this.#count = this.#framed = 0;
    this.view?.begin(size);
  }

  /** Takes Gaussians in addition to those that are there, or instead of them. */
  add(packed: Packed, instead = false): void {
    this.#parts = instead ? [packed] : [...this.#parts, packed];
    this.#count = instead ? packed.count : this.#count + packed.count;
    if (!this.orbit.touched && !this.orbit.placed && this.#count >= 1.5 * this.#framed) {
      frameSplats(this.orbit, this.#parts);
      this.#framed = this.#count;
    }
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

  resize(): void {
    this.view?.resize();
    this.touch();
  }

  touch(): void {
    this.#stale = true;
    if (this.view) this.view.touch();
    else if (this.#count) this.#painting ??= this.#paint();
  }

  /** Paints as long as something changes and there is no view. */
  async #paint(): Promise<void> {
    this.first.classList.add("shown");
    await null; // what else changes in this task is painted with it
    while (this.#stale && !this.view) {
      const shown = this.#shown.splice(0),
        began = performance.now();
      this.#stale = false;
      this.watcher?.(this.camera);
      paint(this.first, { parts: this.#parts, background: this.#background, pose: this.orbit.pose() });
      const took = performance.now() - began;
      await painted();
      for (const resolve of shown) resolve();
      await Promise.race([this.#isEnough, pause(4 * took)]); // most of the time is left to the packets
    }
    this.#painting = null;
  }
}

const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

/** Resolves when what was painted is on the screen. */
function painted(): Promise<void> {
  return new Promise((resolve) => {
    requestAnimationFrame(() => setTimeout(resolve));
    setTimeout(resolve, PATIENCE_MS);
  });
}
