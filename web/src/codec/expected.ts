// Where lost Gaussians are expected, and how large: what a concealer needs of them.

import type { Elements } from "../conceal/conceal.ts";
import { BITS, MAX_LOG, MAX_THIN } from "./gaussians/layout.ts";
import type { SideInfo } from "./gaussians/side_info.ts";
import { THINNESS } from "./gaussians/tables.ts";
import type { Splats } from "./splats.ts";

/** Powers of the plastic number's four-dimensional cousin: multiples of them fill a box evenly (Roberts, 2018). */
const GOLDEN = [0.8191725134, 0.6710436067, 0.5497004779];

/** Received Gaussians of a block, or a gap. */
export interface Run {
  readonly splats: Splats | null;
  readonly count: number;
}

/** All elements of a scene: the received ones as they are; the lost ones at places of received ones of their block, of its mean size. */
export function expectedElements(info: SideInfo, blocks: readonly (readonly Run[])[]): Elements {
  const count = blocks.flat().reduce((sum, run) => sum + run.count, 0);
  const positions = new Float32Array(3 * count), sizes = new Float32Array(count), known = new Uint8Array(count);
  const opacities = new Float32Array(count);
  let at = 0;
  blocks.forEach((runs, block) => {
    const there = runs.filter((run) => run.splats !== null);
    const near = new Float32Array(there.reduce((sum, run) => sum + 3 * run.count, 0));
    there.reduce((end, run) => (near.set(run.splats!.means, end), end + 3 * run.count), 0);
    const lost = runs.reduce((sum, run) => sum + (run.splats ? 0 : run.count), 0), size = meanSize(info, block);
    let gone = 0;
    for (const run of runs) {
      if (run.splats) {
        positions.set(run.splats.means, 3 * at);
        opacities.set(run.splats.opacities, at);
        known.fill(1, at, at + run.count);
        for (let i = 0; i < run.count; i++) sizes[at + i] = Math.cbrt(run.splats.scales[3 * i] * run.splats.scales[3 * i + 1] * run.splats.scales[3 * i + 2]);
      } else {
        sizes.fill(size, at, at + run.count);
        for (let i = 0; i < run.count; i++, gone++) positions.set(place(info, block, near, gone, lost), 3 * (at + i));
      }
      at += run.count;
    }
  });
  return { positions, sizes, opacities, known };
}

function place(info: SideInfo, block: number, near: Float32Array, gone: number, lost: number): ArrayLike<number> {
  if (near.length) {
    const from = 3 * Math.floor((gone * (near.length / 3)) / lost);
    return near.subarray(from, from + 3);
  }
  const unit = 2 ** (info.sizeLog - info.unit), { shifts, corners, extents } = info.boxes;
  return GOLDEN.map((step, a) => {
    const side = (extents[3 * block + a] + 1) * 2 ** shifts[block];
    return (corners[3 * block + a] + side * ((0.5 + (gone + 1) * step) % 1)) * unit;
  });
}

function meanSize(info: SideInfo, block: number): number {
  const [, s0, long, thin] = info.defaults.subarray(7 * block, 7 * block + 7), clip = (v: number, a: number, b: number): number => Math.min(Math.max(v, a), b);
  const first = clip(s0, -MAX_LOG, MAX_LOG), second = first - clip(long, 0, MAX_LOG);
  return 2 ** (info.sizeLog + (first + 2 * second - THINNESS[clip(thin, 0, MAX_THIN)]) / 3 / 2 ** BITS);
}
