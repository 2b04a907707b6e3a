// A clip as an entity of PlayCanvas.

import { type AppBase, type CameraComponent, Entity, type Layer } from "playcanvas";

import type { Clip } from "../clip.ts";
import { GpuGaussians } from "../render/gpu_gaussians.ts";
import type { Packed } from "../render/packed.ts";

/** Smallest capacity of a set of textures, Gaussians. */
const MIN_CAPACITY = 4096;

/**
 * Entity that shows a clip and plays it with the application: `app.root.addChild(new ClipEntity(app, clip))`. Keeps the
 * axes of the stream. While it is disabled, no frames are decoded. Sets `app.scene.gsplat.antiAlias` if the stream
 * requires it. Throws for devices without WebGL.
 */
export class ClipEntity extends Entity {
  /** Child entity; its scale is the unit of length of the frames. */
  readonly #child: Entity;
  /** Gaussians of the newest frame. */
  #current: GpuGaussians | null = null;
  /** Gaussians of the previous frame; their memory is reused once the newest frame is sorted. */
  #previous: GpuGaussians | null = null;
  /** True if a camera has not sorted the newest frame yet. It draws the one before until then. */
  #isWaiting = false;
  /** True if all cameras that draw the entity have sorted it in this picture; null if none has drawn it. */
  #isSorted: boolean | null = null;
  readonly #release: () => void;

  constructor(
    readonly app: AppBase,
    readonly clip: Clip,
  ) {
    super("clip", app);
    if (!app.graphicsDevice.isWebGL2) throw new Error("clips need a graphics device with WebGL 2");
    this.#child = new Entity("frame", app);
    this.#child.setLocalScale(clip.size, clip.size, clip.size);
    this.addChild(this.#child);
    const events = [
      app.on("update", () => this.#update()),
      app.systems.gsplat!.on("frame:ready", (_camera: CameraComponent, layer: Layer, isReady: boolean) => {
        if (this.#child.gsplat?.layers.includes(layer.id)) this.#isSorted = isReady && this.#isSorted !== false;
      }),
      app.on("postrender", () => {
        if (this.#isSorted) this.#isWaiting = false;
        this.#isSorted = null;
      }),
    ];
    this.#release = () => {
      for (const event of events) event.off();
    };
  }

  /** Releases the textures. The clip stays open. */
  override destroy(): void {
    this.#release();
    super.destroy();
    this.#current?.destroy();
    this.#previous?.destroy();
    this.#current = this.#previous = null;
  }

  #update(): void {
    if (!this.enabled) return;
    const frame = this.#isWaiting ? null : this.clip.update();
    if (frame) this.#show(frame.packed);
    if (this.#isWaiting) this.app.renderNextFrame = true; // for applications that draw on request
  }

  #show(packed: Packed): void {
    const last = this.#current,
      next = this.#roomFor(packed);
    next.clear();
    next.append(packed);
    next.show();
    // never reset, because other streams of the application may require it
    if (this.clip.antialiased) this.app.scene.gsplat.antiAlias = true;
    if (this.#child.gsplat) this.#child.gsplat.resource = next;
    else this.#child.addComponent("gsplat", { resource: next });
    this.#current = next;
    this.#previous = last;
    this.#isWaiting = true;
  }

  /** Returns textures that are not drawn and have room for a frame. */
  #roomFor({ count, degree }: Packed): GpuGaussians {
    const spare = this.#previous;
    if (spare && spare.capacity >= count && spare.degree === degree) return spare;
    spare?.destroy();
    return new GpuGaussians(this.app.graphicsDevice, Math.max(MIN_CAPACITY, 2 ** Math.ceil(Math.log2(count))), degree);
  }
}
