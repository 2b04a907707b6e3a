// Quantisation steps of motion, derived from those of the track's keyframe Gaussian.

import {
  ASSUMED_ELONGATION,
  BITS,
  CLASS,
  DIRECTION_BITS,
  ELONGATION,
  FLATNESS,
  OPACITY,
  SCALE0,
  STEP_COLOUR,
  STEP_DIRECTION,
  STEP_ELONGATION,
  STEP_FLATNESS,
  STEP_OPACITY,
  STEP_POSITION,
  STEP_SCALE0,
} from "../gaussians/layout.ts";
import type { SideInfo } from "../gaussians/side_info.ts";
import { Steps } from "../gaussians/steps.ts";
import { flatnessTable } from "../gaussians/tables.ts";
import { KIND_OF, NUM_CHANNELS } from "./layout.ts";

const MAX_SHIFT = 30;

/** Limits log2 of a step. */
export function limitShift(shift: number): number {
  return Math.min(Math.max(shift, 0), MAX_SHIFT);
}

/** log2 of the steps of each channel. */
export class MotionSteps {
  readonly #steps: Steps;

  constructor(
    readonly info: SideInfo,
    readonly logStepRatios: readonly number[],
    /** log2 of half the lattice spacing of `info`, in units of motion. */
    readonly latticeShift: number,
  ) {
    this.#steps = new Steps(info.baseExponents);
  }

  /** Computes the steps for the keyframe Gaussian with integers from index `row`. Writes them to `out` from `at`. */
  of(rows: Float64Array, row: number, out: Int32Array, at: number): void {
    const steps = this.#steps,
      { latticeBits, maxPositionShift } = this.info,
      precisionClass = rows[row + CLASS],
      opacity = rows[row + OPACITY],
      s0 = rows[row + SCALE0],
      elongation = rows[row + ELONGATION],
      flatness = flatnessTable()[rows[row + FLATNESS]],
      area = 2 * s0 - elongation;
    const finest = Math.max(
        steps.exponent(STEP_POSITION, precisionClass, area, elongation, flatness, opacity),
        1 - ((s0 - elongation) >> BITS),
      ),
      position = Math.min(Math.max(latticeBits - finest, 0), Math.max(maxPositionShift, 0)) + 1,
      turn = DIRECTION_BITS - steps.exponent(STEP_DIRECTION, precisionClass, area, elongation, flatness, opacity),
      last = steps.shift(STEP_FLATNESS, precisionClass, area, elongation, 0, opacity, BITS - 1),
      own = [
        position,
        Math.min(Math.max(turn, 0), DIRECTION_BITS - 2),
        0,
        steps.shift(STEP_OPACITY, precisionClass, 0, 0, 0, 0, BITS),
        steps.shift(STEP_COLOUR, precisionClass, 0, 0, 0, 0, BITS - 2),
      ];
    own[0] += this.latticeShift;
    for (let c = 0; c < NUM_CHANNELS; c++) out[at + c] = own[KIND_OF[c]];
    out[at + 6] = steps.shift(STEP_SCALE0, precisionClass, 0, 0, 0, opacity, BITS - 1);
    out[at + 7] = steps.shift(STEP_ELONGATION, precisionClass, 2 * s0 - ASSUMED_ELONGATION, 0, 0, opacity, BITS - 1);
    out[at + 8] = Math.min(last + (flatness >> BITS), BITS - 1);
    for (let c = 0; c < NUM_CHANNELS; c++) out[at + c] = limitShift(out[at + c] + this.logStepRatios[KIND_OF[c]]);
  }
}
