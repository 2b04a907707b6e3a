// Free space for the camera: outside of objects, and near enough to see the scene.

import { HALF_FLOAT_VALUES, type Packed } from "./packed.ts";
import type { SceneCore } from "./scene_core.ts";

/** Cells per side of the grid, and its width relative to the scene's radius. */
const GRID_CELLS = 72,
  GRID_WIDTH = 3;
/** Largest number of Gaussians in the grid. If the scene has more, each represents several. */
const MAX_SAMPLES = 60_000;
/** Optical depth of an opaque layer of cells, where less than 1/e of the light passes. */
const OPAQUE_DEPTH = 1;
/** Points per half axis over which a large Gaussian is spread. */
const MAX_POINTS = 6;
/** Number of Gaussians that define the local density radius. */
const DENSITY_COUNT = 48;
/** Cone in the view direction: half width at distance 1, and least covered share for the scene to count as in view. */
const CONE = 0.3,
  MIN_COVERAGE = 0.01;

export class FreeSpace {
  readonly middle: readonly number[];
  readonly radius: number;
  /** Side of a cell. */
  readonly cell: number;
  readonly #opticalDepth = new Float32Array(GRID_CELLS ** 3);
  /** Samples, shape (samples, 4): x, y, z and area. */
  readonly #samples: Float32Array;
  /** Number of Gaussians that each sample represents. */
  readonly #step: number;

  constructor({ middle, radius }: SceneCore, parts: readonly Packed[]) {
    this.middle = middle;
    this.radius = radius;
    this.cell = (GRID_WIDTH * radius) / GRID_CELLS;
    this.#step = Math.max(Math.floor(parts.reduce((sum, { count }) => sum + count, 0) / MAX_SAMPLES), 1);
    this.#samples = new Float32Array(4 * parts.reduce((sum, { count }) => sum + Math.ceil(count / this.#step), 0));
    let filled = 0;
    for (const part of parts) filled = this.#add(part, filled);
  }

  /** Returns the radius of the sphere around a point that contains `SOME` Gaussians. */
  densityRadius([x, y, z]: readonly number[]): number {
    const samples = this.#samples,
      squares = Float64Array.from(
        { length: samples.length / 4 },
        (_, i) => (samples[4 * i] - x) ** 2 + (samples[4 * i + 1] - y) ** 2 + (samples[4 * i + 2] - z) ** 2,
      ).sort();
    return Math.sqrt(squares[Math.min(Math.ceil(DENSITY_COUNT / this.#step), squares.length) - 1] ?? 0);
  }

  /** Returns true if part of the scene is in view from a point in the given direction, a unit vector. */
  sceneInView([x, y, z]: readonly number[], [dx, dy, dz]: readonly number[]): boolean {
    const samples = this.#samples;
    let covered = 0;
    for (let i = 0; i < samples.length; i += 4) {
      const [a, b, c] = [samples[i] - x, samples[i + 1] - y, samples[i + 2] - z],
        depth = a * dx + b * dy + c * dz;
      if (depth > 0 && a * a + b * b + c * c < (1 + CONE ** 2) * depth ** 2) covered += samples[i + 3] / depth ** 2;
    }
    return covered > MIN_COVERAGE * Math.PI * CONE ** 2;
  }

  /** Returns the transmittance from a point to an eye, without what is at the point itself. */
  transmittance(eye: readonly number[], point: readonly number[]): number {
    const way = [0, 1, 2].map((a) => eye[a] - point[a]),
      steps = Math.ceil(Math.hypot(...way) / this.cell);
    let thick = 0;
    for (let n = 2; n <= steps; n++) {
      const share = n / steps,
        at = this.#at(point[0] + share * way[0], point[1] + share * way[1], point[2] + share * way[2]);
      if (at >= 0) thick += this.#opticalDepth[at];
    }
    return Math.exp(-thick);
  }

  /** Returns true if a camera may be at a point: no opaque layer is within a cell. */
  isFree([x, y, z]: readonly number[]): boolean {
    let thick = 0;
    for (let n = 0; n < 27; n++) {
      const [i, j, k] = [(n % 3) - 1, (((n / 3) | 0) % 3) - 1, ((n / 9) | 0) - 1],
        at = this.#at(x + i * this.cell, y + j * this.cell, z + k * this.cell);
      if (at >= 0) thick += this.#opticalDepth[at];
    }
    return thick < 9 * OPAQUE_DEPTH;
  }

  #at(x: number, y: number, z: number): number {
    const { middle, cell } = this,
      i = Math.floor((x - middle[0]) / cell + GRID_CELLS / 2),
      j = Math.floor((y - middle[1]) / cell + GRID_CELLS / 2),
      k = Math.floor((z - middle[2]) / cell + GRID_CELLS / 2);
    return Math.min(i, j, k) < 0 || Math.max(i, j, k) >= GRID_CELLS ? -1 : (i * GRID_CELLS + j) * GRID_CELLS + k;
  }

  /** Adds the optical depth of each Gaussian to the cells along its two longer axes. */
  #add({ count, centers, scales, rotations, opacities }: Packed, filled: number): number {
    const step = this.#step;
    for (let i = 0; i < count; i += step, filled++) {
      // the bits of positive half floats sort like their values
      const sizes = [scales[4 * i], scales[4 * i + 1], scales[4 * i + 2]],
        longest = sizes.indexOf(Math.max(...sizes)),
        second = 3 - longest - sizes.lastIndexOf(Math.min(...sizes)),
        s = HALF_FLOAT_VALUES[sizes[longest]],
        t = HALF_FLOAT_VALUES[sizes[second]],
        area = step * opacities[i] * Math.PI * s * t,
        thick = area / this.cell ** 2,
        m = Math.min(Math.round(s / this.cell), MAX_POINTS),
        n = Math.min(Math.round(t / this.cell), MAX_POINTS);
      this.#samples.set([centers[4 * i], centers[4 * i + 1], centers[4 * i + 2], area], 4 * filled);
      const u = m ? axisOf(rotations, i, longest) : ZERO,
        v = n ? axisOf(rotations, i, second) : ZERO,
        share = thick / ((2 * m + 1) * (2 * n + 1));
      for (let a = -m; a <= m; a++) {
        for (let b = -n; b <= n; b++) {
          const [along, across] = [m && (a / m) * s, n && (b / n) * t];
          const at = this.#at(
            centers[4 * i] + along * u[0] + across * v[0],
            centers[4 * i + 1] + along * u[1] + across * v[1],
            centers[4 * i + 2] + along * u[2] + across * v[2],
          );
          if (at >= 0) this.#opticalDepth[at] += share;
        }
      }
    }
    return filled;
  }
}

const ZERO: readonly number[] = [0, 0, 0];

/** Returns a column of a Gaussian's rotation matrix. */
function axisOf(turns: Uint16Array, i: number, axis: number): readonly number[] {
  const [w, x, y, z] = [0, 1, 2, 3].map((a) => HALF_FLOAT_VALUES[turns[4 * i + a]]);
  if (axis === 0) return [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)];
  if (axis === 1) return [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)];
  return [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
}
