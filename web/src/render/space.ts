// Where a camera may be: not inside of things, whose insides fill the picture with grey, and not so far away that there
// is nothing to see.

import type { Core } from "./core.ts";
import { FLOATS, type Packed } from "./packed.ts";

/** Cells on a side, over the scene's width and half of it more. */
const CELLS = 72,
  WIDTH = 3;
/** Gaussians that are looked at; each stands for others where there are more. */
const MOST = 60_000;
/** A layer of cells is full where it lets through less than 1/e of the light. */
const FULL = 1;
/** Points that a large Gaussian is dealt to along an axis, on each side. */
const MOST_POINTS = 6;
/** Gaussians of which a thing can be told. */
const SOME = 48;
/**
 * Of a cone around where a camera looks, which any window shows: its half width at distance 1, and the share of it
 * that is covered where something is in sight.
 */
const CONE = 0.3,
  COVERED = 0.01;

export class Space {
  readonly middle: readonly number[];
  readonly radius: number;
  /** Length of a cell's side. */
  readonly cell: number;
  readonly #thick = new Float32Array(CELLS ** 3);
  /** x, y, z and area of each of those that are looked at. */
  readonly #samples: Float32Array;
  /** How many of a scene each of them stands for. */
  readonly #step: number;

  constructor({ middle, radius }: Core, parts: readonly Packed[]) {
    this.middle = middle;
    this.radius = radius;
    this.cell = (WIDTH * radius) / CELLS;
    this.#step = Math.max(Math.floor(parts.reduce((sum, { count }) => sum + count, 0) / MOST), 1);
    this.#samples = new Float32Array(4 * parts.reduce((sum, { count }) => sum + Math.ceil(count / this.#step), 0));
    let filled = 0;
    for (const part of parts) filled = this.#add(part, filled);
  }

  /** Radius of the ball around a point that holds so many Gaussians that a thing can be told. */
  grain([x, y, z]: readonly number[]): number {
    const samples = this.#samples,
      squares = Float64Array.from(
        { length: samples.length / 4 },
        (_, i) => (samples[4 * i] - x) ** 2 + (samples[4 * i + 1] - y) ** 2 + (samples[4 * i + 2] - z) ** 2,
      ).sort();
    return Math.sqrt(squares[Math.min(Math.ceil(SOME / this.#step), squares.length) - 1] ?? 0);
  }

  /** Whether something is in sight of a camera that looks in a direction, a unit vector. */
  ahead([x, y, z]: readonly number[], [dx, dy, dz]: readonly number[]): boolean {
    const samples = this.#samples;
    let covered = 0;
    for (let i = 0; i < samples.length; i += 4) {
      const [a, b, c] = [samples[i] - x, samples[i + 1] - y, samples[i + 2] - z],
        depth = a * dx + b * dy + c * dz;
      if (depth > 0 && a * a + b * b + c * c < (1 + CONE ** 2) * depth ** 2) covered += samples[i + 3] / depth ** 2;
    }
    return covered > COVERED * Math.PI * CONE ** 2;
  }

  /** Share of light that passes from a point to an eye, but for what is at the point itself. */
  light(eye: readonly number[], point: readonly number[]): number {
    const way = [0, 1, 2].map((a) => eye[a] - point[a]),
      steps = Math.ceil(Math.hypot(...way) / this.cell);
    let thick = 0;
    for (let n = 2; n <= steps; n++) {
      const share = n / steps,
        at = this.#at(point[0] + share * way[0], point[1] + share * way[1], point[2] + share * way[2]);
      if (at >= 0) thick += this.#thick[at];
    }
    return Math.exp(-thick);
  }

  /** Whether a camera may be there: no layer of a thing is within a cell. */
  free([x, y, z]: readonly number[]): boolean {
    let thick = 0;
    for (let n = 0; n < 27; n++) {
      const [i, j, k] = [(n % 3) - 1, (((n / 3) | 0) % 3) - 1, ((n / 9) | 0) - 1],
        at = this.#at(x + i * this.cell, y + j * this.cell, z + k * this.cell);
      if (at >= 0) thick += this.#thick[at];
    }
    return thick < 9 * FULL;
  }

  #at(x: number, y: number, z: number): number {
    const { middle, cell } = this,
      i = Math.floor((x - middle[0]) / cell + CELLS / 2),
      j = Math.floor((y - middle[1]) / cell + CELLS / 2),
      k = Math.floor((z - middle[2]) / cell + CELLS / 2);
    return Math.min(i, j, k) < 0 || Math.max(i, j, k) >= CELLS ? -1 : (i * CELLS + j) * CELLS + k;
  }

  /** Deals each Gaussian's shadow to the cells that its two longer axes lie in. */
  #add({ count, centers, scales, turns, opacities }: Packed, filled: number): number {
    const step = this.#step;
    for (let i = 0; i < count; i += step, filled++) {
      const sizes = [scales[4 * i], scales[4 * i + 1], scales[4 * i + 2]], // bits of halves are in their order
        longest = sizes.indexOf(Math.max(...sizes)),
        second = 3 - longest - sizes.lastIndexOf(Math.min(...sizes)),
        s = FLOATS[sizes[longest]],
        t = FLOATS[sizes[second]],
        area = step * opacities[i] * Math.PI * s * t,
        thick = area / this.cell ** 2,
        m = Math.min(Math.round(s / this.cell), MOST_POINTS),
        n = Math.min(Math.round(t / this.cell), MOST_POINTS);
      this.#samples.set([centers[4 * i], centers[4 * i + 1], centers[4 * i + 2], area], 4 * filled);
      const u = m ? axisOf(turns, i, longest) : ZERO,
        v = n ? axisOf(turns, i, second) : ZERO,
        share = thick / ((2 * m + 1) * (2 * n + 1));
      for (let a = -m; a <= m; a++) {
        for (let b = -n; b <= n; b++) {
          const [along, across] = [m && (a / m) * s, n && (b / n) * t];
          const at = this.#at(
            centers[4 * i] + along * u[0] + across * v[0],
            centers[4 * i + 1] + along * u[1] + across * v[1],
            centers[4 * i + 2] + along * u[2] + across * v[2],
          );
          if (at >= 0) this.#thick[at] += share;
        }
      }
    }
    return filled;
  }
}

const ZERO: readonly number[] = [0, 0, 0];

/** A column of the rotation of a Gaussian. */
function axisOf(turns: Uint16Array, i: number, axis: number): readonly number[] {
  const [w, x, y, z] = [0, 1, 2, 3].map((a) => FLOATS[turns[4 * i + a]]);
  if (axis === 0) return [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)];
  if (axis === 1) return [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)];
  return [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
}
