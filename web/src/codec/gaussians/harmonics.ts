// Harmonics of one Gaussian, a channel after another; most are 0, and what came before is the context.

import type { RangeDecoder } from "../../entropy/decoder.ts";
import { FIRST_HARMONIC, MAX_HARMONIC, MAX_RESIDUAL } from "./layout.ts";

/** Least running magnitude, in sixteenths, of each context but the first. */
const RUNNING = [2, 6, 13, 24, 42, 74, 135];

export function decodeHarmonics(coder: RangeDecoder, models: Int32Array, values: Int32Array, level: number, shift: number): void {
  if (!coder.bit(models, FIRST_HARMONIC + Math.min(level & 7, 7))) return;
  const number = values.length / 3, step = 2 ** shift;
  let running = 0;
  for (let j = 0; j < values.length; j++) {
    const band = j % number, degree = band < 3 ? 0 : band < 8 ? 1 : 2;
    let context = 0;
    while (context < 7 && running >= RUNNING[context]) context++;
    const value = coefficient(coder, models, FIRST_HARMONIC + 8 + (context * 3 + degree) * 2 + (j >= number ? 1 : 0), context);
    values[j] = Math.min(Math.max(value * step, -MAX_HARMONIC), MAX_HARMONIC);
    running = ((running * 13) >> 4) + Math.min(Math.abs(value), 65536) * 16;
  }
}

function coefficient(coder: RangeDecoder, models: Int32Array, zero: number, context: number): number {
  if (!coder.bit(models, zero)) return 0;
  const sign = coder.raw(1) ? -1 : 1, base = FIRST_HARMONIC + 56 + context * 3;
  for (let size = 1; size < 15; size++) if (!coder.bit(models, base + Math.min(size - 1, 2))) return sign * size;
  return sign * (15 + Math.min(coder.gamma(), MAX_RESIDUAL, 1 << 20));
}
