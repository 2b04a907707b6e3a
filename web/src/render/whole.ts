// A scene without levels, or a frame of a clip, on the graphics card.

import { type AppBase, Entity, WORKBUFFER_UPDATE_ONCE } from "playcanvas";

import { Gaussians } from "./container.ts";
import type { Packed } from "./packed.ts";

const FIRST_ROOM = 4096;

export class WholeGaussians {
  readonly #entity: Entity;
  #parts: Packed[] = [];
  #gains: Float32Array | null = null;
  #drawn: Gaussians | null = null;
  /** What those took the place of, on the screen until they are sorted; the next ones are written over it. */
  #before: Gaussians | null = null;

  constructor(readonly app: AppBase) {
    this.#entity = new Entity("scene", app);
    app.root.addChild(this.#entity);
  }

  get count(): number {
    return this.#drawn?.count ?? 0;
  }

  /** Whether there are any: whether others can take their place. */
  get any(): boolean {
    return this.#drawn !== null;
  }

  /** Takes Gaussians in addition to those that are there. */
  add(packed: Packed): void {
    this.#parts.push(packed);
    const count = this.#parts.reduce((sum, part) => sum + part.count, 0);
    if (!this.#drawn || this.#drawn.capacity < count) this.#enlarge(count, packed.degree);
    else this.#drawn.add(packed);
  }

  /**
   * Begins anew beside what is on the screen, which is not written over: in an order of depths that is not its own,
   * what comes would be torn wherever rows are other Gaussians than they were.
   *
   * @param sorted Whether what is there is on the screen, and not still that before.
   */
  replace(sorted: boolean): void {
    this.#parts = [];
    this.#gains = null;
    const last = this.#drawn;
    if (!last) return;
    this.#drawn = (sorted && this.#before) || new Gaussians(this.app.graphicsDevice, last.capacity, last.degree);
    this.#drawn.clear();
    this.#entity.gsplat!.resource = this.#drawn;
    if (sorted) this.#before = last;
    else last.destroy();
  }

  /** Gains of size and opacity in turn, by order of arrival; null for none. Those that came later are as they are. */
  setGains(gains: Float32Array | null): void {
    this.#gains = gains;
    this.#drawn?.setGains(gains ?? new Float32Array(2 * this.count).fill(1));
  }

  /** Has what is drawn taken from where it lies once more, and sorted. */
  again(): void {
    if (this.#entity.gsplat) this.#entity.gsplat.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
  }

  /** Gives back what is needed only while others come. */
  rest(): void {
    this.#before?.destroy();
    this.#before = null;
  }

  clear(): void {
    if (this.#entity.gsplat) this.#entity.removeComponent("gsplat");
    this.rest();
    this.#drawn?.destroy();
    this.#drawn = this.#gains = null;
    this.#parts = [];
  }

  #enlarge(count: number, degree: number): void {
    const room = Math.max(FIRST_ROOM, 2 ** Math.ceil(Math.log2(count))),
      larger = new Gaussians(this.app.graphicsDevice, room, degree);
    for (const part of this.#parts) larger.add(part);
    if (this.#gains) larger.setGains(this.#gains);
    if (this.#entity.gsplat) this.#entity.removeComponent("gsplat");
    this.#entity.addComponent("gsplat", { resource: larger });
    this.rest();
    this.#drawn?.destroy();
    this.#drawn = larger;
  }
}
