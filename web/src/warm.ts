// The engine compiles what runs often, and compiles it once more as it runs: noise is decoded while nothing has come
// yet.

import { NUM_CONTEXTS, SECONDS, SPREADS, STEPS, STREAMS } from "./codec/gaussians/layout.ts";
import { PacketDecoder } from "./codec/gaussians/packet.ts";
import type { SideInfo } from "./codec/gaussians/side_info.ts";
import { toSplats } from "./codec/gaussians/to_splats.ts";
import { pack } from "./render/packed.ts";
import { nextTurn } from "./turns.ts";

/**
 * Few at a time, for the session waits meanwhile; in the end as many as it takes until decoding is no faster any more.
 */
const AT_A_TIME = 32,
  ENOUGH = 8192,
  DEGREE = 3,
  NUMBER = 15,
  BYTES = 512;

const INFO: SideInfo = {
  degree: DEGREE,
  numHarmonics: 3 * NUMBER,
  sizeLog: 0,
  unit: 16,
  coarsest: 8,
  sections: new Map(),
  bases: new Int32Array(STEPS).fill(256),
  transform: Int8Array.from({ length: NUMBER * NUMBER }, (_, n) => (n % (NUMBER + 1) ? 0 : 127)),
  boxes: {
    shifts: Int32Array.of(8),
    corners: new Float64Array(3),
    extents: new Uint8Array(3).fill(255),
    bits: Int32Array.of(16),
  },
  defaults: new Int32Array(7),
  models: new Int32Array(2 * NUM_CONTEXTS).fill(32768),
  scales: Int32Array.from({ length: STREAMS * SPREADS * SECONDS }, (_, n) => 4 * (n % 16)),
};

/** Decodes noise until it is no longer wanted, or it is enough. */
export async function warmUp(wanted: () => boolean): Promise<void> {
  const decoder = new PacketDecoder(INFO),
    noise = Uint8Array.from({ length: BYTES }, (_, n) => Math.imul(n + 1, 0x9e3779b1) >>> 24);
  for (let n = 0; n < ENOUGH && wanted(); n += AT_A_TIME) {
    noise[0] = n / AT_A_TIME;
    pack([toSplats(decoder.decode(noise, 0, AT_A_TIME), INFO, 0)], DEGREE, 1);
    await nextTurn();
  }
}
