// Selection of the tiles that a view shows and needs next. Counterpart of `splatwire.bitstream.tile_selection`.

import type { Camera } from "../../model/camera.ts";
import { cameraPosition } from "../../model/camera.ts";
import type { Tiles } from "./tiles.ts";

/** Largest number of Gaussians in a view. */
export const BUDGET = 1_000_000;
/** Screen-space error, pixels, below which finer tiles are not selected. */
const MIN_SCREEN_ERROR = 0.48;
/** Weight of the error of tiles outside the picture. It is above 0 because the camera may turn. */
const OUTSIDE_WEIGHT = 0.05;
/** Smallest distance of a tile, as a multiple of its half diagonal. */
const MIN_DISTANCE_RATIO = 0.02;

export type ViewCamera = Pick<Camera, "viewmat" | "focal" | "width" | "height">;

export interface Cut {
  /**
   * Tiles to draw, ascending, together with their coarser ancestors. The Gaussians of an ancestor that represent drawn
   * tiles are skipped.
   */
  readonly drawn: readonly number[];
  /** Selected tiles that are not received completely, most useful first. */
  readonly wanted: readonly number[];
}

/**
 * Returns the screen-space error without a tile, pixels, and the tile's usefulness: covered area per byte.
 *
 * For tiles in the picture, the area is that of the bounding rectangle. For others it is the mean over all directions.
 * Without a camera both values are the error in world units. The coarsest level has an infinite error because nothing
 * replaces it.
 */
function tileUtility(tiles: Tiles, tile: number, camera: ViewCamera | null, eye: readonly number[]): [number, number] {
  const parent = tiles.parents[tile],
    error = parent < 0 ? Infinity : tiles.errors[parent];
  if (!camera) return [error, error];
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
  const distance = Math.max(length(outside), Math.max(2 * MIN_DISTANCE_RATIO * length(half), 1e-9)),
    center = camera.viewmat.map((row) => row[0] * middle[0] + row[1] * middle[1] + row[2] * middle[2] + row[3]),
    reach = camera.viewmat.map(
      (row) => Math.abs(row[0]) * half[0] + Math.abs(row[1]) * half[1] + Math.abs(row[2]) * half[2],
    ),
    near = Math.max(center[2] - reach[2], distance),
    far = Math.max(center[2] + reach[2], near);
  let seen = center[2] + reach[2] > 0,
    covered = 1;
  for (const [axis, edge] of [camera.width / 2 / camera.focal, camera.height / 2 / camera.focal].entries()) {
    const low = center[axis] - reach[axis],
      high = center[axis] + reach[axis],
      extent = Math.min(high / (high < 0 ? far : near), edge) - Math.max(low / (low < 0 ? near : far), -edge);
    seen &&= extent > 0;
    covered = covered * extent * camera.focal;
  }
  const [a, b, c] = half,
    scale = camera.focal / distance,
    weight = seen ? 1 : OUTSIDE_WEIGHT;
  if (!seen) covered = Math.min(2 * (a * b + b * c + c * a) * scale * scale, camera.width * camera.height);
  const size = Math.max(tiles.offsets[tile + 1] - tiles.offsets[tile], 1);
  return [((error * camera.focal) / distance) * weight, parent < 0 ? Infinity : (covered * weight) / size];
}

const length = ([x, y, z]: readonly number[]): number => Math.sqrt(x * x + y * y + z * z);

/**
 * Selects tiles by usefulness until the budget is spent or all errors are small.
 *
 * An infinite budget selects every tile. `isComplete` is true for complete tiles, `drawable` for tiles with enough
 * packets.
 */
export function cutOf(
  tiles: Tiles,
  isComplete: (tile: number) => boolean,
  camera: ViewCamera | null,
  budget = BUDGET,
  drawable = isComplete,
): Cut {
  const chosen = selectedTiles(tiles, camera, budget),
    isDrawn = new Uint8Array(tiles.count),
    drawn: number[] = [],
    wanted: number[] = [];
  for (const tile of chosen) {
    isDrawn[tile] = Number(drawable(tile));
    if (!isComplete(tile)) wanted.push(tile);
  }
  for (let tile = 0; tile < tiles.count; tile++) {
    const parent = tiles.parents[tile];
    if (parent >= 0 && !isDrawn[parent]) isDrawn[tile] = 0; // coarser tiles have smaller indices
    if (isDrawn[tile]) drawn.push(tile);
  }
  return { drawn, wanted };
}

/** Returns the selected tiles, most useful first. A coarser tile precedes its children. */
function selectedTiles(tiles: Tiles, camera: ViewCamera | null, budget: number): number[] {
  if (budget === Infinity) return Array.from({ length: tiles.count }, (_, tile) => tile);
  const { count, parents, numGaussians } = tiles,
    eye = camera ? cameraPosition(camera) : [],
    minError = camera ? MIN_SCREEN_ERROR : 0,
    errors = new Float64Array(count),
    usefulness = new Float64Array(count),
    selected: number[] = [];
  for (let tile = 0; tile < count; tile++) {
    const [error, utility] = tileUtility(tiles, tile, camera, eye),
      parent = parents[tile];
    errors[tile] = parent < 0 ? error : Math.min(error, errors[parent]);
    usefulness[tile] = parent < 0 ? utility : Math.min(utility, usefulness[parent]);
    if (errors[tile] > minError) selected.push(tile);
  }
  selected.sort((a, b) => (usefulness[a] === usefulness[b] ? a - b : usefulness[b] - usefulness[a]));
  let spent = 0;
  const end = selected.findIndex((tile) => (spent += numGaussians[tile]) > budget && parents[tile] >= 0);
  return end < 0 ? selected : selected.slice(0, end);
}

/** Returns, for each Gaussian of a tile, the child tile with the nearest box; -1 if the tile has no children. */
export function assignToChildren({ children, low, high }: Tiles, tile: number, means: Float32Array): Int32Array {
  const finer = children[tile];
  return Int32Array.from({ length: means.length / 3 }, (_, n) => {
    let best = -1,
      least = Infinity;
    for (const child of finer) {
      let outside = 0;
      for (let a = 0; a < 3; a++) {
        const at = means[3 * n + a];
        outside = Math.max(outside, low[3 * child + a] - at, at - high[3 * child + a]);
      }
      if (outside < least) [best, least] = [child, outside];
    }
    return best;
  });
}
