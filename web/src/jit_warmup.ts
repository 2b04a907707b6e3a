// JIT warm-up: decodes random bytes before the first packet arrives, so that the engine has compiled the decoder by
// then.

import {
  NUM_CONTEXTS,
  NUM_DEVIATION_CONTEXTS,
  NUM_MAGNITUDE_CONTEXTS,
  RESIDUAL_KINDS,
  STEPS,
} from "./codec/gaussians/layout.ts";
import { FastPacketDecoder } from "./codec/gaussians/native.ts";
import type { SideInfo } from "./codec/gaussians/side_info.ts";
import { toSplats } from "./codec/gaussians/to_splats.ts";
import { pack } from "./render/packed.ts";
import { nextTask } from "./scheduler.ts";

/**
 * Gaussians per batch and in total. Small batches keep the session responsive; more than the total no longer speeds up
 * decoding.
 */
const BATCH = 32,
  MAX_DECODED = 8192,
  DEGREE = 3,
  NUMBER = 15,
  BYTES = 512;

const INFO: SideInfo = {
  degree: DEGREE,
  numHarmonicColumns: 3 * NUMBER,
  sizeLog: 0,
  latticeBits: 16,
  maxPositionShift: 8,
  sections: new Map(),
  baseExponents: new Int32Array(STEPS).fill(256),
  transform: Int8Array.from({ length: NUMBER * NUMBER }, (_, n) => (n % (NUMBER + 1) ? 0 : 127)),
  boxes: {
    shifts: Int32Array.of(8),
    corners: new Float64Array(3),
    extents: new Uint8Array(3).fill(255),
    bits: Int32Array.of(16),
  },
  blockMeans: new Int32Array(7),
  models: new Int32Array(2 * NUM_CONTEXTS).fill(32768),
  scaleIndices: Int32Array.from(
    { length: RESIDUAL_KINDS * NUM_DEVIATION_CONTEXTS * NUM_MAGNITUDE_CONTEXTS },
    (_, n) => 4 * (n % 16),
  ),
};

/** Decodes random bytes until `wanted` returns false or the code is compiled. */
export async function warmUp(wanted: () => boolean): Promise<void> {
  const decoder = new FastPacketDecoder(INFO),
    noise = Uint8Array.from({ length: BYTES }, (_, n) => Math.imul(n + 1, 0x9e3779b1) >>> 24);
  for (let n = 0; n < MAX_DECODED && wanted(); n += BATCH) {
    noise[0] = n / BATCH;
    pack([toSplats(decoder.decode(noise, 0, BATCH), INFO, 0)], DEGREE, 1);
    await nextTask();
  }
}
