// Tiles of a scene with levels on the graphics card, each by itself: what changes is uploaded, and nothing else.

import { type AppBase, Entity, type GSplatFormat, WORKBUFFER_UPDATE_ONCE } from "playcanvas";

import { nextTurn, SLICE_MS } from "../turns.ts";
import { formatOf, Gaussians } from "./container.ts";
import type { Tile } from "./packed.ts";

/** Swaps that come within so long are shown together: whatever is drawn is sorted anew after each. */
const TOGETHER_MS = 100;

interface Drawn {
  readonly entity: Entity;
  readonly gaussians: Gaussians;
}

export class TiledGaussians {
  readonly #drawn = new Map<number, Drawn>();
  /** Uploaded, and not shown yet. */
  readonly #ready = new Map<number, Gaussians>();
  #queue: { gone: readonly number[]; come: readonly Tile[] }[] = [];
  #gone = new Set<number>();
  #old: Gaussians[] = [];
  #format: GSplatFormat | null = null;
  #working: Promise<void> | null = null;
  #over = false;

  constructor(
    readonly app: AppBase,
    readonly changed: () => void,
  ) {}

  get count(): number {
    let count = 0;
    for (const { gaussians } of this.#drawn.values()) count += gaussians.count;
    return count;
  }

  /** Whether what was given last is shown. */
  get settled(): boolean {
    return !this.#working;
  }

  recut(gone: readonly number[], come: readonly Tile[]): void {
    this.#queue.push({ gone, come });
    this.#working ??= this.#work().finally(() => (this.#working = null));
  }

  /** Uploads what comes, a little in each task, and shows it where the tiles that it takes the place of go. */
  async #work(): Promise<void> {
    let since = performance.now(),
      shown = since;
    for (let next = this.#queue.shift(); next && !this.#over; next = this.#queue.shift()) {
      for (const tile of next.gone) {
        if (!this.#discard(tile)) this.#gone.add(tile);
      }
      for (const { tile, packed } of next.come) {
        if (performance.now() - since > SLICE_MS) {
          await nextTurn();
          if (this.#over) return;
          since = performance.now();
        }
        this.#format ??= formatOf(this.app.graphicsDevice, packed.degree);
        const gaussians = new Gaussians(this.app.graphicsDevice, packed.count, packed.degree, this.#format);
        gaussians.add(packed);
        this.#gone.delete(tile);
        this.#ready.set(tile, gaussians);
      }
      if (!this.#queue.length || performance.now() - shown > TOGETHER_MS) {
        this.#show();
        shown = performance.now();
      }
    }
  }

  /** Takes away what was uploaded and not shown yet. */
  #discard(tile: number): boolean {
    const gaussians = this.#ready.get(tile);
    this.#ready.delete(tile);
    gaussians?.destroy();
    return gaussians !== undefined && !this.#drawn.has(tile);
  }

  #show(): void {
    for (const tile of [...this.#gone, ...this.#ready.keys()]) {
      const drawn = this.#drawn.get(tile);
      if (!drawn) continue;
      drawn.entity.destroy();
      this.#old.push(drawn.gaussians);
      this.#drawn.delete(tile);
    }
    for (const [tile, gaussians] of this.#ready) {
      const entity = new Entity(`tile ${tile}`, this.app);
      this.app.root.addChild(entity);
      entity.addComponent("gsplat", { resource: gaussians });
      this.#drawn.set(tile, { entity, gaussians });
    }
    this.#gone.clear();
    this.#ready.clear();
    this.changed();
  }

  /** Has what is drawn sorted once more. */
  again(): void {
    const first = this.#drawn.values().next().value;
    if (first) first.entity.gsplat!.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
  }

  /** What is drawn is sorted: nothing refers any more to what was drawn before. */
  sorted(): void {
    if (this.#working) return;
    for (const gaussians of this.#old.splice(0)) gaussians.destroy();
  }

  /** Gains of size and opacity of all, in turn, by ascending tile; null for none. Others are not heard. */
  setGains(gains: Float32Array | null): void {
    if (gains && gains.length !== 2 * this.count) return;
    let at = 0;
    for (const [, { gaussians, entity }] of [...this.#drawn].sort(([a], [b]) => a - b)) {
      const { count } = gaussians;
      gaussians.setGains(gains ? gains.subarray(at, at + 2 * count) : new Float32Array(2 * count).fill(1));
      entity.gsplat!.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
      at += 2 * count;
    }
  }

  destroy(): void {
    this.#over = true;
    for (const { entity } of this.#drawn.values()) entity.destroy();
    const all = [...this.#ready.values(), ...this.#old, ...[...this.#drawn.values()].map(({ gaussians }) => gaussians)];
    for (const gaussians of all) gaussians.destroy();
    this.#drawn.clear();
    this.#ready.clear();
    this.#old = [];
  }
}
