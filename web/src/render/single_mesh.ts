// GPU mesh of a static scene or of one frame of a clip.

import { type AppBase, Entity, WORKBUFFER_UPDATE_ONCE } from "playcanvas";

import { GpuGaussians } from "./gpu_gaussians.ts";
import type { Packed } from "./packed.ts";

const MIN_CAPACITY = 4096;
/** Maximum number of Gaussians for which memory is reserved before their arrival. */
const MAX_RESERVED = 1 << 18;

export class SingleMesh {
  readonly #entity: Entity;
  #parts: Packed[] = [];
  #numAdded = 0;
  #gains: Float32Array | null = null;
  /** Newest Gaussians, which `add` fills; on the screen once they are shown and sorted. */
  #current: GpuGaussians | null = null;
  /** Larger memory with everything added, which replaces `#current` when it is shown; null if there is enough room. */
  #larger: GpuGaussians | null = null;
  /** Replaced Gaussians, on the screen until the new ones are sorted. Their memory is then reused. */
  #previous: GpuGaussians | null = null;

  /** Number of Gaussians that are expected in total; 0 if it is unknown. */
  expected = 0;

  constructor(readonly app: AppBase) {
    this.#entity = new Entity("scene", app);
    app.root.addChild(this.#entity);
  }

  /** Number of Gaussians that are drawn or being sorted; those in `#larger` do not count yet. */
  get count(): number {
    return this.#current?.count ?? 0;
  }

  /** True if no Gaussians were added. */
  get isEmpty(): boolean {
    return !this.#numAdded;
  }

  /** True if the Gaussians added now replace others that were shown. */
  get replacesDrawn(): boolean {
    return this.#current !== null;
  }

  /** Uploads Gaussians. They are drawn after `show`. Returns the number of uploaded bytes. */
  add(packed: Packed): number {
    const target = this.#larger ?? this.#current;
    this.#parts.push(packed);
    this.#numAdded += packed.count;
    if (!target || target.capacity < this.#numAdded || target.degree !== packed.degree)
      return this.#enlarge(packed.degree);
    const before = target.bytes;
    target.append(packed);
    return target.bytes - before;
  }

  /** True if `show` will draw larger memory instead of that on the screen. */
  get isGrowing(): boolean {
    return this.#larger !== null;
  }

  /** Hides Gaussians for good, by index in the order of arrival. */
  hide(which: Int32Array): void {
    (this.#larger ?? this.#current)?.hide(which);
  }

  /** Draws everything added. It is sorted first. */
  show(): void {
    const larger = this.#larger;
    if (larger) {
      if (this.#entity.gsplat) this.#entity.removeComponent("gsplat");
      this.#entity.addComponent("gsplat", { resource: larger });
      this.releaseSpare();
      this.#current?.destroy();
      this.#current = larger;
      this.#larger = null;
    }
    if (this.#gains) this.#current?.setGains(this.#gains);
    this.#current?.show();
  }

  /**
   * Starts a new set of Gaussians in separate memory. Overwriting the drawn ones would mix them with another set's
   * depth order.
   *
   * @param sorted True if the current set is on the screen, false if it is still the one before.
   */
  replace(sorted: boolean): void {
    this.#parts = [];
    this.#numAdded = 0;
    this.#gains = null;
    this.#larger?.destroy();
    this.#larger = null;
    const last = this.#current;
    if (!last) return;
    this.#current = (sorted && this.#previous) || new GpuGaussians(this.app.graphicsDevice, last.capacity, last.degree);
    this.#current.clear();
    this.#entity.gsplat!.resource = this.#current;
    if (sorted) this.#previous = last;
    else last.destroy();
  }

  /**
   * Applies gains of size and opacity, shape (count, 2), by order of arrival; null resets them. Later Gaussians keep
   * gain 1.
   */
  setGains(gains: Float32Array | null): void {
    this.#gains = gains;
    this.#current?.setGains(gains ?? new Float32Array(2 * this.count).fill(1));
  }

  /** Requests another copy and depth sort. */
  resort(): void {
    if (this.#entity.gsplat) this.#entity.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
  }

  /** Releases memory that is needed only during replacement. */
  releaseSpare(): void {
    this.#previous?.destroy();
    this.#previous = null;
  }

  clear(): void {
    if (this.#entity.gsplat) this.#entity.removeComponent("gsplat");
    this.releaseSpare();
    this.#current?.destroy();
    this.#larger?.destroy();
    this.#current = this.#larger = this.#gains = null;
    this.#parts = [];
    this.#numAdded = 0;
  }

  /** Uploads everything added to larger memory. Returns the number of uploaded bytes. */
  #enlarge(degree: number): number {
    const count = this.#numAdded,
      expected = Math.min(this.expected, MAX_RESERVED),
      room = count <= expected ? expected : Math.max(MIN_CAPACITY, 2 ** Math.ceil(Math.log2(count)));
    this.#larger?.destroy();
    this.#larger = new GpuGaussians(this.app.graphicsDevice, room, degree);
    for (const part of this.#parts) this.#larger.append(part);
    return this.#larger.bytes;
  }
}
