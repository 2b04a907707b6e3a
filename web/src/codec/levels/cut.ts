// Which tiles a view shows, and which it needs next: the twin of `splatwire.packets.view`.

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

/**
 * Refines where the screen's error is largest, until the budget is spent or the error is small everywhere. A tile gives
 * way to the finer ones that it stands for when all of them are there.
 */
export function cutOf(tiles: Tiles, there: (tile: number) => boolean, look: Look | null, budget = BUDGET): Cut {
  const { count, parents, children } = tiles,
    real = Uint8Array.from({ length: count }, (_, tile) => Number(there(tile))),
    refined = refinedTiles(tiles, look, budget),
    givingWay = new Uint8Array(count),
    drawn: number[] = [],
    wanted: number[] = [];
  for (let root = 0; root < count && parents[root] < 0; root++) if (!real[root]) wanted.push(root);
  for (const tile of refined) {
    const absent = children[tile].filter((child) => !real[child]);
    wanted.push(...absent);
    givingWay[tile] = Number(!absent.length);
  }
  for (let tile = 0; tile < count; tile++) {
    const parent = parents[tile];
    if (parent >= 0 && !(real[parent] && givingWay[parent])) real[tile] = 0; // coarser tiles come before finer ones
    if (real[tile] && !givingWay[tile]) drawn.push(tile);
  }
  return { drawn, wanted };
}

/** Tiles whose finer ones are shown or wanted, the most useful first: no tile before what stands for it. */
function refinedTiles(tiles: Tiles, look: Look | null, budget: number): number[] {
  const { count, parents, children, gaussians } = tiles,
    eye = look ? eyeOf(look) : [],
    least = look ? FINE_ENOUGH : 0,
    urgent = new Float64Array(count),
    some: number[] = [];
  let spent = 0;
  for (let tile = 0; tile < count; tile++) {
    const error = pixelError(tiles, tile, look, eye),
      parent = parents[tile];
    urgent[tile] = parent < 0 ? error : Math.min(error, urgent[parent]);
    if (parent < 0) spent += gaussians[tile];
    if (children[tile].length && urgent[tile] > least) some.push(tile);
  }
  some.sort((a, b) => urgent[b] - urgent[a] || a - b);
  const end = some.findIndex((tile) => {
    spent = children[tile].reduce((sum, child) => sum + gaussians[child], spent - gaussians[tile]);
    return spent > budget;
  });
  return end < 0 ? some : some.slice(0, end);
}
