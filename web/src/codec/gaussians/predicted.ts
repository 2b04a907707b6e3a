// Predicted positions and sizes of lost Gaussians, for the concealers.

import type { Elements } from "../../conceal/elements.ts";
import type { Plan } from "../../packets/plan.ts";
import type { GaussianBatch } from "./gaussian_batch.ts";
import { BITS, MAX_COMPANDED, MAX_LOG } from "./layout.ts";
import type { SideInfo } from "./side_info.ts";
import { flatnessTable } from "./tables.ts";

const MIN_SCALE = 1e-9,
  RECEIVED = 1,
  COPIED = 2;
/** Inverse powers of the root of x^4 = x + 1. Multiples of them fill a box evenly (R sequence, Roberts, 2018). */
const R_SEQUENCE = [0.8191725134, 0.6710436067, 0.5497004779];

/**
 * Returns the properties of all Gaussians: those of the batches, then the lost ones. Redundant copies are the last
 * batch. Lost ones get the mean size of their block and the positions of its received Gaussians.
 */
export function predictedElements(info: SideInfo, plan: Plan, batches: readonly GaussianBatch[]): Elements {
  const { count } = plan.manifest,
    positions = new Float32Array(3 * count),
    sizes = new Float32Array(count),
    isReceived = new Uint8Array(count);
  const logScales = new Float32Array(3 * count),
    indices = new Int32Array(count),
    state = new Uint8Array(count);
  const opacities = new Float32Array(count),
    blocks = Array.from({ length: plan.numBlocks }, (): GaussianBatch[] => []),
    orders = blocks.map((_, block) => plan.elementsOf(block)); // before the members of any batch are looked up
  let at = 0;
  for (const batch of batches) {
    const { splats, packet } = batch;
    positions.set(splats.means, 3 * at);
    opacities.set(splats.opacities, at);
    isReceived.fill(1, at, at + splats.count);
    indices.set(batch.indices, at);
    for (const index of indices.subarray(at, at + splats.count)) state[index] = packet ? RECEIVED : COPIED;
    for (let i = 0; i < splats.count; i++, at++) {
      const [a, b, c] = [0, 1, 2].map((axis) => Math.log(Math.max(splats.scales[3 * i + axis], MIN_SCALE)));
      logScales[3 * at] = Math.max(a, b, c);
      logScales[3 * at + 1] = Math.max(Math.min(a, b), Math.min(Math.max(a, b), c));
      logScales[3 * at + 2] = Math.min(a, b, c);
      sizes[at] = Math.exp((a + b + c) / 3);
    }
    if (packet) blocks[packet.block].push(batch);
  }
  blocks.forEach((received, block) => {
    received.sort((a, b) => a.packet!.indexInBlock - b.packet!.indexInBlock);
    const near = new Float32Array(received.reduce((sum, batch) => sum + 3 * batch.splats.count, 0)),
      size = meanSize(info, block);
    let end = 0;
    for (const { splats } of received) {
      near.set(splats.means, end);
      end += 3 * splats.count;
    }
    orders[block]
      .filter((index) => state[index] !== RECEIVED)
      .forEach((index, gone, lost) => {
        if (state[index] === COPIED) return;
        sizes[at] = size;
        indices[at] = index;
        positions.set(predictedCentre(info, block, near, gone, lost.length), 3 * at++);
      });
  });
  return { positions, sizes, tierSizes: null, opacities, isReceived, indices, logScales, anchors: null };
}

function predictedCentre(
  info: SideInfo,
  block: number,
  near: Float32Array,
  gone: number,
  lost: number,
): ArrayLike<number> {
  if (near.length) {
    const from = 3 * Math.floor((gone * (near.length / 3)) / lost);
    return near.subarray(from, from + 3);
  }
  const unit = 2 ** (info.sizeLog - info.latticeBits),
    { shifts, corners, extents } = info.boxes;
  return R_SEQUENCE.map((step, a) => {
    const side = (extents[3 * block + a] + 1) * 2 ** shifts[block];
    return (corners[3 * block + a] + side * ((0.5 + (gone + 1) * step) % 1)) * unit;
  });
}

function meanSize(info: SideInfo, block: number): number {
  const [, s0, elongation, companded] = info.blockMeans.subarray(7 * block, 7 * block + 7),
    clip = (v: number, a: number, b: number): number => Math.min(Math.max(v, a), b);
  const first = clip(s0, -MAX_LOG, MAX_LOG),
    second = first - clip(elongation, 0, MAX_LOG);
  return (
    2 ** (info.sizeLog + (first + 2 * second - flatnessTable()[clip(companded, 0, MAX_COMPANDED)]) / 3 / 2 ** BITS)
  );
}
