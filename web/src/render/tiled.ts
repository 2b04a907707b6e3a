// Tiles of a scene with levels on the graphics card, each by itself: what changes is uploaded, and nothing else.

import { type AppBase, Entity, type GSplatFormat, WORKBUFFER_UPDATE_ONCE } from "playcanvas";

import { nextTurn, pause, SLICE_MS } from "../turns.ts";
import type { Card } from "./card.ts";
import { formatOf, Gaussians } from "./container.ts";
import type { Tile } from "./packed.ts";

/** Swaps that come within so long are shown together: whatever is drawn is sorted anew after each. */
const TOGETHER_MS = 100;
/** What the card is handed before it has to keep up, bytes, and how long to wait until it is asked again. */
const MOST_BYTES = 1 << 22,
  BUSY_MS = 4;

interface Drawn {
  readonly entity: Entity;
  readonly gaussians: Gaussians;
}

/** Swaps one after another, and gains of what they leave. */
type Work =
  | { readonly gone: readonly number[]; readonly come: readonly Tile[] }
  | { readonly gains: Float32Array | null; readonly done: () => void };

export class TiledGaussians {
  readonly #drawn = new Map<number, Drawn>();
  /** Uploaded, and not shown yet. */
  readonly #ready = new Map<number, Gaussians>();
  #queue: Work[] = [];
  #gone = new Set<number>();
  #old: Gaussians[] = [];
  #format: GSplatFormat | null = null;
  #working: Promise<void> | null = null;
  #over = false;
  /** Handed to the card since it was waited for, and when others had their turn. */
  #handed = 0;
  #since = 0;

  constructor(
    readonly app: AppBase,
    readonly card: Card,
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
    this.#do({ gone, come });
  }

  /**
   * Gains of size and opacity of all that was given, in turn, by ascending tile; null for none. Others are not heard.
   * Resolves when they are on the card.
   */
  setGains(gains: Float32Array | null): Promise<void> {
    return new Promise((done) => this.#do({ gains, done }));
  }

  #do(work: Work): void {
    this.#queue.push(work);
    this.#working ??= this.#work().finally(() => (this.#working = null));
  }

  /** Uploads what comes, a little in each task, and shows it where the tiles that it takes the place of go. */
  async #work(): Promise<void> {
    let shown = performance.now();
    this.#since = shown;
    for (let next = this.#queue.shift(); next; next = this.#queue.shift()) {
      if ("come" in next) await this.#swap(next.gone, next.come);
      else {
        this.#show();
        await this.#gain(next.gains);
        next.done();
      }
      if (!this.#over && (!this.#queue.length || performance.now() - shown > TOGETHER_MS)) {
        this.#show();
        shown = performance.now();
      }
    }
  }

  async #swap(gone: readonly number[], come: readonly Tile[]): Promise<void> {
    for (const tile of gone) {
      if (!this.#discard(tile)) this.#gone.add(tile);
    }
    for (const { tile, packed } of come) {
      if (this.#over) return;
      this.#format ??= formatOf(this.app.graphicsDevice, packed.degree);
      const gaussians = new Gaussians(this.app.graphicsDevice, packed.count, packed.degree, this.#format);
      gaussians.add(packed);
      this.#gone.delete(tile);
      this.#ready.set(tile, gaussians);
      await this.#pace(gaussians.bytes);
    }
  }

  async #gain(gains: Float32Array | null): Promise<void> {
    if (gains && gains.length !== 2 * this.count) return;
    let at = 0;
    this.changed();
    for (const [, { gaussians, entity }] of [...this.#drawn].sort(([a], [b]) => a - b)) {
      if (this.#over) return;
      const { count } = gaussians,
        bytes = gaussians.setGains(gains ? gains.subarray(at, at + 2 * count) : new Float32Array(2 * count).fill(1));
      if (bytes) entity.gsplat!.workBufferUpdate = WORKBUFFER_UPDATE_ONCE;
      at += 2 * count;
      await this.#pace(bytes);
    }
  }

  /** Waits for the card where that has much to do, and for others where this took long. */
  async #pace(bytes: number): Promise<void> {
    this.#handed += bytes;
    const much = this.#handed > MOST_BYTES;
    if (!much && performance.now() - this.#since < SLICE_MS) return;
    if (much) this.card.mark();
    do await (much ? pause(BUSY_MS) : nextTurn());
    while (much && !this.#over && !this.card.idle);
    if (much) this.#handed = 0;
    this.#since = performance.now();
  }

  /** Takes away what was uploaded and not shown yet. */
  #discard(tile: number): boolean {
    const gaussians = this.#ready.get(tile);
    this.#ready.delete(tile);
    gaussians?.destroy();
    return gaussians !== undefined && !this.#drawn.has(tile);
  }

  #show(): void {
    if (this.#over || (!this.#gone.size && !this.#ready.size)) return;
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
