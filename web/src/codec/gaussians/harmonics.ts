// Spherical harmonics of a Gaussian, three channels per coefficient. Most are 0; the earlier ones are the context.

import type { RangeDecoder } from "../../entropy/decoder.ts";
import { FIRST_HARMONIC, FIRST_MAGNITUDE, MAX_HARMONIC, MAX_RESIDUAL } from "./layout.ts";

/** Lower bounds of the decaying sum of magnitudes, in sixteenths, from context 1 on. */
const MAGNITUDE_BOUNDS = Int32Array.of(2, 6, 13, 24, 42, 74, 135);

export function decodeHarmonics(
  coder: RangeDecoder,
  models: Int32Array,
  values: Int32Array,
  first: number,
  count: number,
  precisionClass: number,
  shift: number,
): void {
  if (!coder.bit(models, FIRST_HARMONIC + Math.min(precisionClass & 7, 7))) return;
  const step = 2 ** shift;
  let magnitudeSum = 0;
  for (let j = 0; j < count; j++) {
    const group = j < 3 ? 0 : j < 9 ? 1 : j < 21 ? 2 : 3;
    let context = 0;
    while (context < 7 && magnitudeSum >= MAGNITUDE_BOUNDS[context]) context++;
    const value = coefficient(coder, models, FIRST_HARMONIC + 8 + (context * 4 + group) * 2 + (j % 3 ? 1 : 0), context);
    values[first + j] = Math.min(Math.max(value * step, -MAX_HARMONIC), MAX_HARMONIC);
    magnitudeSum = ((magnitudeSum * 13) >> 4) + Math.min(Math.abs(value), 65536) * 16;
  }
}

function coefficient(coder: RangeDecoder, models: Int32Array, zeroContext: number, context: number): number {
  if (!coder.bit(models, zeroContext)) return 0;
  const sign = coder.raw(1) ? -1 : 1,
    base = FIRST_MAGNITUDE + context * 3;
  for (let size = 1; size < 15; size++) if (!coder.bit(models, base + Math.min(size - 1, 2))) return sign * size;
  return sign * (15 + Math.min(coder.gamma(), MAX_RESIDUAL, 1 << 20));
}
