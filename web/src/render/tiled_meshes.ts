// GPU tiles of a scene with levels. Only changed tiles are uploaded.

import { type AppBase, Entity, type GSplatFormat, WORKBUFFER_UPDATE_ONCE } from "playcanvas";

import { GpuGaussians, textureFormat } from "./gpu_gaussians.ts";
import { type GpuFence, UploadSlices } from "./gpu_limits.ts";
import type { Tile } from "./packed.ts";

/** Interval at which swaps become visible, milliseconds. Each one requires sorting the whole scene. */
const SHOW_INTERVAL_MS = 100;

interface DrawnTile {
  readonly entity: Entity;
  readonly gaussians: GpuGaussians;
}

/** Queued work: a swap, or gains for the tiles after the earlier swaps. */
type Work =
  | { readonly removed: readonly number[]; readonly added: readonly Tile[] }
  | { readonly gains: Float32Array | null; readonly done: () => void };

export class TiledMeshes {
  readonly #drawn = new Map<number, DrawnTile>();
  /** Uploaded tiles that are not drawn yet. */
  readonly #ready = new Map<number, GpuGaussians>();
  #queue: Work[] = [];
  #removed = new Set<number>();
  #replaced: GpuGaussians[] = [];
  #format: GSplatFormat | null = null;
  #working: Promise<void> | null = null;
  #destroyed = false;
  readonly #slices: UploadSlices;

  constructor(
    readonly app: AppBase,
    readonly gpu: GpuFence,
    readonly changed: () => void,
    readonly failed: (error: Error) => void,
  ) {
    this.#slices = new UploadSlices(gpu, () => this.#destroyed);
  }

  get count(): number {
    let count = 0;
    for (const { gaussians } of this.#drawn.values()) count += gaussians.count;
    return count;
  }

  /** True if all queued work is done. */
  get settled(): boolean {
    return !this.#working;
  }

  replaceTiles(removed: readonly number[], added: readonly Tile[]): void {
    this.#enqueue({ removed, added });
  }

  /**
   * Applies gains of size and opacity, shape (count, 2), of all Gaussians by ascending tile; null resets them. Gains of
   * another length are ignored. Resolves after the upload.
   */
  setGains(gains: Float32Array | null): Promise<void> {
    return new Promise((done) => this.#enqueue({ gains, done }));
  }

  #enqueue(work: Work): void {
    this.#queue.push(work);
    this.#working ??= this.#process().finally(() => (this.#working = null));
  }

  /** Processes the queue: uploads in slices, and shows new tiles and removes the replaced ones together. */
  async #process(): Promise<void> {
    let shown = performance.now();
    this.#slices.begin();
    for (let next = this.#queue.shift(); next; next = this.#queue.shift()) {
      try {
        if ("added" in next) await this.#swap(next.removed, next.added);
        else {
          this.#show();
          await this.#applyGains(next.gains);
        }
        if (!this.#destroyed && (!this.#queue.length || performance.now() - shown > SHOW_INTERVAL_MS)) {
          this.#show();
          shown = performance.now();
        }
      } catch (error) {
        this.failed(error as Error); // such as too little memory
      }
      if ("done" in next) next.done();
    }
  }

  async #swap(removed: readonly number[], added: readonly Tile[]): Promise<void> {
    for (const tile of removed) {
      if (!this.#discard(tile)) this.#removed.add(tile);
    }
    for (const { tile, packed } of added) {
      if (this.#destroyed) return;
      this.#format ??= textureFormat(this.app.graphicsDevice, packed.degree);
      const gaussians = new GpuGaussians(this.app.graphicsDevice, packed.count, packed.degree, this.#format);
      gaussians.append(packed);
      gaussians.show();
      this.#removed.delete(tile);
      this.#ready.set(tile, gaussians);
      await this.#slices.after(gaussians.bytes);
    }
  }

  async #applyGains(gains: Float32Array | null): Promise<void> {
    if (gains && gains.length !== 2 * this.count) return;
    let at = 0;
    this.changed();
    for (const [, { gaussians, entity }] of [...this.#drawn].sort(([a], [b]) => a - b)) {
      if (this.#destroyed) return;
      const { count } = gaussians,
        bytes = gaussians.setGains(gains ? gains.subarray(at, at + 2 * count) : new Float32Array(2 * count).fill(1));
      if (bytes) entity.gsplat!.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
      at += 2 * count;
      await this.#slices.after(bytes);
    }
  }

  /** Removes an uploaded tile that is not drawn yet. */
  #discard(tile: number): boolean {
    const gaussians = this.#ready.get(tile);
    this.#ready.delete(tile);
    gaussians?.destroy();
    return gaussians !== undefined && !this.#drawn.has(tile);
  }

  #show(): void {
    if (this.#destroyed || (!this.#removed.size && !this.#ready.size)) return;
    for (const tile of [...this.#removed, ...this.#ready.keys()]) {
      const drawn = this.#drawn.get(tile);
      if (!drawn) continue;
      drawn.entity.destroy();
      this.#replaced.push(drawn.gaussians);
      this.#drawn.delete(tile);
    }
    for (const [tile, gaussians] of this.#ready) {
      const entity = new Entity(`tile ${tile}`, this.app);
      this.app.root.addChild(entity);
      entity.addComponent("gsplat", { resource: gaussians });
      this.#drawn.set(tile, { entity, gaussians });
    }
    this.#removed.clear();
    this.#ready.clear();
    this.changed();
  }

  /** Requests another depth sort. */
  resort(): void {
    const first = this.#drawn.values().next().value;
    if (first) first.entity.gsplat!.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
  }

  /** Notes that the drawn Gaussians are sorted. Replaced ones are then no longer in use, and are destroyed. */
  noteSorted(): void {
    if (this.#working) return;
    for (const gaussians of this.#replaced.splice(0)) gaussians.destroy();
  }

  destroy(): void {
    this.#destroyed = true;
    for (const { entity } of this.#drawn.values()) entity.destroy();
    const all = [
      ...this.#ready.values(),
      ...this.#replaced,
      ...[...this.#drawn.values()].map(({ gaussians }) => gaussians),
    ];
    for (const gaussians of all) gaussians.destroy();
    this.#drawn.clear();
    this.#ready.clear();
    this.#replaced = [];
  }
}
