// Which tiles a view shows, and which it needs next: the twin of `splatwire.levels.view`.

import type { Camera } from "../../model/camera.ts";
import { eyeOf } from "../../model/camera.ts";
import type { Tiles } from "./tiles.ts";

/** Gaussians that a view shows at most. */
export const BUDGET = 1_000_000;
/** Pixels by which centres may be off: finer tiles are not worth their bytes. */
const FINE_ENOUGH = 0.5;
/** What the error of a tile counts for that is not in the picture: somebody may turn. */
const BEHIND = 0.05;
/** Least distance of a tile, relative to its diagonal. */
const NEAREST = 0.02;

export type Look = Pick<Camera, "viewmat" | "focal" | "width" | "height">;

export interface Cut {
  /** Tiles to draw, ascending; they stand for the whole scene as far as it is there. */
  readonly drawn: readonly number[];
  /** Tiles that are not there, the most useful first. */
  readonly wanted: readonly number[];
}

/** How far centres in a tile are off on the screen, pixels; without a look as in world units. */
function pixelError(tiles: Tiles, tile: number, look: Look | null, eye: readonly number[]): number {
  if (!look) return tiles.errors[tile];
  const middle = [0, 0, 0],
    half = [0, 0, 0],
    outside = [0, 0, 0];
  for (let a = 0; a < 3; a++) {
    const low = tiles.low[3 * tile + a],
      high = tiles.high[3 * tile + a];
    middle[a] = (low + high) / 2;
    half[a] = (high - low) / 2;
    outside[a] = Math.max(Math.abs(eye[a] - middle[a]) - half[a], 0);
  }
  const radius = length(half),
    distance = Math.max(length(outside), Math.max(2 * NEAREST * radius, 1e-9));
  const [x, y, z] = look.viewmat.map((row) => row[0] * middle[0] + row[1] * middle[1] + row[2] * middle[2] + row[3]);
  const across = look.width / 2 / look.focal,
    down = look.height / 2 / look.focal;
  const seen =
    z > -radius &&
    Math.abs(x) - across * z <= radius * Math.sqrt(1 + across * across) &&
    Math.abs(y) - down * z <= radius * Math.sqrt(1 + down * down);
  return ((tiles.errors[tile] * look.focal) / distance) * (seen ? 1 : BEHIND);
}

const length = ([x, y, z]: readonly number[]): number => Math.sqrt(x * x + y * y + z * z);

interface Waiting {
  readonly error: number;
  readonly tile: number;
  readonly real: boolean;
}

/** Whether one comes out before another: the larger error, then the lower number. */
const before = (a: Waiting, b: Waiting): boolean => a.error > b.error || (a.error === b.error && a.tile < b.tile);

/**
 * Refines where the screen's error is largest, until the budget is spent or the error is small everywhere. A tile gives
 * way to the finer ones that it stands for when all of them are there.
 */
export function cutOf(tiles: Tiles, there: (tile: number) => boolean, look: Look | null, budget = BUDGET): Cut {
  const eye = look ? eyeOf(look) : [],
    least = look ? FINE_ENOUGH : 0,
    drawn: number[] = [],
    wanted: number[] = [],
    heap: Waiting[] = [];
  const wait = (tile: number, real: boolean): void =>
    push(heap, { error: pixelError(tiles, tile, look, eye), tile, real });
  let count = 0;
  for (let root = 0; root < tiles.count && tiles.parents[root] < 0; root++) {
    count += tiles.gaussians[root];
    if (!there(root)) wanted.push(root);
    wait(root, there(root));
  }
  for (let next = pop(heap); next; next = pop(heap)) {
    const { error, tile, real } = next,
      finer = tiles.children[tile],
      more = finer.reduce((sum, child) => sum + tiles.gaussians[child], -tiles.gaussians[tile]);
    if (!finer.length || error <= least || count + more > budget) {
      if (real) drawn.push(tile);
      continue;
    }
    count += more;
    const absent = finer.filter((child) => !there(child));
    wanted.push(...absent);
    if (real && absent.length) drawn.push(tile);
    for (const child of finer) wait(child, real && !absent.length);
  }
  return { drawn: drawn.sort((a, b) => a - b), wanted };
}

function push(heap: Waiting[], one: Waiting): void {
  let at = heap.push(one) - 1;
  while (at > 0 && before(one, heap[(at - 1) >> 1])) {
    heap[at] = heap[(at - 1) >> 1];
    at = (at - 1) >> 1;
  }
  heap[at] = one;
}

function pop(heap: Waiting[]): Waiting | undefined {
  const first = heap[0],
    last = heap.pop();
  if (!last || !heap.length) return first;
  let at = 0;
  for (let child = 1; child < heap.length; child = 2 * at + 1) {
    if (child + 1 < heap.length && before(heap[child + 1], heap[child])) child++;
    if (!before(heap[child], last)) break;
    heap[at] = heap[child];
    at = child;
  }
  heap[at] = last;
  return first;
}
