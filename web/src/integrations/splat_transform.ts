// splat-transform splat-transform.mjs -p file=scene.swz OUTPUT: converts a stream to any output format of PlayCanvas's
// splat-transform.

import { readFile } from "node:fs/promises";

import { decode, type Gaussians } from "../decoder.ts";
import { type Columns, plyColumns } from "./columns.ts";
import { warnOfLeftOut, warnOfLosses } from "./losses.ts";

interface Parameters {
  readonly name: string;
  readonly value: string;
}

/** Generator interface of splat-transform. */
export class Generator {
  readonly columnNames: string[];
  readonly #columns: Columns;

  private constructor(
    readonly count: number,
    columns: Columns,
  ) {
    this.columnNames = columns.map(([name]) => name);
    this.#columns = columns;
  }

  /** Parameters: `file`, the stream; `concealer`, by default `grow`; `frame`, for clips. */
  static async create(given: readonly Parameters[]): Promise<Generator> {
    const fields = Object.fromEntries(given.map(({ name, value }) => [name, value])),
      { file, concealer = "grow", frame, ...unknown } = fields;
    const [other] = Object.keys(unknown);
    if (other !== undefined) throw new Error(`unknown parameter '${other}'; parameters are file, concealer and frame`);
    if (!file) throw new Error("the stream is missing: -p file=scene.swz");
    const scene = await decode(new Uint8Array(await readFile(file)), {
      concealer,
      ...(frame === undefined ? {} : { frame: Number(frame || Number.NaN) }),
    });
    warnOfLosses(scene, file);
    warnOfLeftOut(scene, file);
    const { gaussians } = scene;
    return new Generator(gaussians.count, plyColumns(turned(gaussians)));
  }

  getRow(index: number, row: Record<string, number>): void {
    for (const [name, values] of this.#columns) row[name] = values[index];
  }
}

/**
 * Rotates by 180 degrees around z. Streams have the axes of a PLY file, splat-transform those of PlayCanvas with y up.
 */
function turned(gaussians: Gaussians): Gaussians {
  const { degree } = gaussians,
    number = (degree + 1) ** 2 - 1,
    rotations = gaussians.rotations.map((_, n, all) => {
      const [w, x, y, z] = all.subarray(n & ~3, (n & ~3) + 4);
      return [-z, -y, x, w][n & 3];
    });
  const centres = gaussians.centres.map((value, n) => (n % 3 === 2 ? value : -value));
  // coefficient j has degree l and order m = j - l^2 - l; odd orders change their sign
  const harmonics = gaussians.harmonics.map((value, n) => {
    const j = (Math.floor(n / 3) % number) + 1,
      l = Math.floor(Math.sqrt(j));
    return (j - l * l - l) % 2 === 0 ? value : -value;
  });
  return { ...gaussians, centres, rotations, harmonics };
}
