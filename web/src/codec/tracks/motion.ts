// Decoder of motion packets: the tracks of a packet and the residuals of their prediction. Any bytes decode to some
// motion.

import { RangeDecoder } from "../../entropy/decoder.ts";
import {
  BEGINS,
  C_ABSENT,
  C_BEGINS,
  C_ENDS,
  C_MOVING,
  C_OCTAVE,
  C_ZERO,
  CANDIDATE_BITS,
  DEGREE_CONTEXTS,
  ENDS,
  GAP_AFTER,
  GAP_BEFORE,
  HEADER_FIELDS,
  KIND_OF,
  MAX_CANDIDATES,
  MAX_OCTAVE,
  MAX_QUANTISED,
  MOVING,
  NEIGHBOUR_CONTEXTS,
  NUM_CHANNELS,
  NUM_KINDS,
  OCTAVE_CONTEXTS,
  STATE,
  TRACK,
  TRACK_BITS,
} from "./layout.ts";

/** Decoded integers of a packet of n tracks over F frames. */
export interface Motion {
  /** Heads, shape (n, HEADER_FIELDS). All entries of a row are -1 if invalid bytes contain fewer tracks. */
  readonly headers: Int32Array;
  /** Residuals in steps, shape (n, channels, F). */
  readonly residuals: Int32Array;
  /** Number of coded coefficients per kind of channel. */
  readonly numCoefficients: Int32Array;
}

export function decodeMotion(
  payload: Uint8Array,
  models: Int32Array,
  count: number,
  frames: number,
  firstNew: number,
): Motion {
  const coder = new RangeDecoder(payload),
    own = models.slice(),
    headers = new Int32Array(HEADER_FIELDS * count).fill(-1),
    residuals = new Int32Array(count * NUM_CHANNELS * frames),
    found = readHeaders(coder, own, headers, count, frames, firstNew),
    numCoefficients = Int32Array.from({ length: NUM_KINDS }, () => coder.below(frames + 1));
  let before = -1;
  for (let i = 0; i < found; i++) {
    if (headers[HEADER_FIELDS * i + STATE] !== MOVING) continue;
    readTrack(coder, own, residuals, i, before, numCoefficients, frames);
    before = i;
  }
  return { headers, residuals, numCoefficients };
}

function readHeaders(
  coder: RangeDecoder,
  models: Int32Array,
  headers: Int32Array,
  count: number,
  frames: number,
  firstNew: number,
): number {
  const first = coder.raw(TRACK_BITS),
    lead = Math.min(coder.gamma(), 1 << 24),
    span = coder.raw(CANDIDATE_BITS),
    tail = Math.min(coder.gamma(), 1 << 24);
  let at = 0,
    gone = 0,
    moved = 0,
    before = first - lead;
  for (let track = first; track < first + Math.min(span, MAX_CANDIDATES); track++) {
    gone = coder.bit(models, C_ABSENT + gone);
    if (gone) continue;
    if (at === count) break;
    const state = coder.bit(models, C_MOVING + moved);
    moved = ((moved << 1) | state) & 3;
    const begins = track >= firstNew && coder.bit(models, C_BEGINS) ? coder.below(frames) : 0,
      ends = coder.bit(models, C_ENDS) ? coder.below(frames) : frames,
      row = HEADER_FIELDS * at++;
    headers[row + TRACK] = track;
    headers[row + STATE] = state;
    headers[row + BEGINS] = begins;
    headers[row + ENDS] = ends;
    headers[row + GAP_BEFORE] = track - before;
    headers[row + GAP_AFTER] = 0;
    before = track + 1;
  }
  if (at) headers[HEADER_FIELDS * (at - 1) + GAP_AFTER] = tail;
  return at;
}

/**
 * Decodes the residuals of one track. Contexts are the largest magnitude so far in the kind, and the channel before.
 */
function readTrack(
  coder: RangeDecoder,
  models: Int32Array,
  residuals: Int32Array,
  i: number,
  before: number,
  numCoefficients: Int32Array,
  frames: number,
): void {
  let largest = 0;
  for (let c = 0; c < NUM_CHANNELS; c++) {
    const kind = KIND_OF[c],
      first = c === 0 || KIND_OF[c - 1] !== kind,
      at = (i * NUM_CHANNELS + c) * frames;
    let own = 0;
    if (first) {
      largest = 0;
      if (before >= 0) own = Math.abs(residuals[(before * NUM_CHANNELS + c) * frames]);
    }
    for (let k = 0; k < numCoefficients[kind]; k++) {
      let near = Math.max(own, largest);
      if (!first) near = Math.max(near, 2 * Math.abs(residuals[at - frames + k]));
      const level = Math.min(near < 2 ** 31 ? 32 - Math.clz32(near) : NEIGHBOUR_CONTEXTS, NEIGHBOUR_CONTEXTS - 1),
        value = readCoefficient(coder, models, kind, k, level);
      residuals[at + k] = value;
      own = k === 0 && first ? Math.abs(value) : Math.max(own, Math.abs(value));
    }
    largest = Math.max(largest, own);
  }
}

function readCoefficient(coder: RangeDecoder, models: Int32Array, kind: number, order: number, level: number): number {
  if (
    !coder.bit(
      models,
      C_ZERO + (kind * DEGREE_CONTEXTS + Math.min(order, DEGREE_CONTEXTS - 1)) * NEIGHBOUR_CONTEXTS + level,
    )
  )
    return 0;
  const base = C_OCTAVE + (kind * NEIGHBOUR_CONTEXTS + level) * OCTAVE_CONTEXTS;
  let octave = 0;
  while (octave < MAX_OCTAVE && coder.bit(models, base + Math.min(octave, OCTAVE_CONTEXTS - 1))) octave++;
  const magnitude = Math.min(2 ** octave + coder.raw(octave), MAX_QUANTISED);
  return coder.raw(1) ? -magnitude : magnitude;
}
