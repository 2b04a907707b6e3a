// Side information of explicit Gaussians with random numbers.

import {
  NUM_CONTEXTS,
  NUM_DEVIATION_CONTEXTS,
  NUM_MAGNITUDE_CONTEXTS,
  RESIDUAL_KINDS,
  STEPS,
} from "../src/codec/gaussians/layout.ts";
import type { SideInfo } from "../src/codec/gaussians/side_info.ts";

/** Returns a generator of integers below its argument. */
export function randomNumbers(seed: number): (below: number) => number {
  let state = seed;
  return (below) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
}

/** Returns side information within the limits of the format. */
export function anySideInfo(random: (below: number) => number): SideInfo {
  const degree = random(4),
    number = (degree + 1) ** 2 - 1,
    boxBits = random(41);
  return {
    degree,
    numHarmonicColumns: 3 * number,
    sizeLog: 0,
    latticeBits: random(41),
    maxPositionShift: random(4) ? random(33) : -1,
    sections: new Map(),
    baseExponents: Int32Array.from({ length: STEPS }, () => random(2000) - 400),
    transform: Int8Array.from({ length: number * number }, () => random(256) - 128),
    boxes: {
      shifts: Int32Array.of(Math.max(boxBits - 8, 0)),
      corners: new Float64Array(3),
      extents: new Uint8Array(3),
      bits: Int32Array.of(boxBits),
    },
    blockMeans: Int32Array.from({ length: 7 }, () => (random(1025) - 512) * 256),
    models: Int32Array.from({ length: 2 * NUM_CONTEXTS }, () => 256 * (1 + random(255))),
    scaleIndices: Int32Array.from(
      { length: RESIDUAL_KINDS * NUM_DEVIATION_CONTEXTS * NUM_MAGNITUDE_CONTEXTS },
      () => 4 * random(random(2) ? 80 : 30),
    ),
  };
}
