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
  DEGREE_CONTEXTS,
  ENDS,
  GAP_AFTER,
  GAP_BEFORE,
  HEADER_FIELDS,
  KIND_OF,
  MAX_OCTAVE,
  MAX_QUANTISED,
  MAX_TRACK_SPAN,
  MOVING,
  NEIGHBOUR_CONTEXTS,
  NUM_CHANNELS,
  NUM_KINDS,
  OCTAVE_CONTEXTS,
  SPAN_BITS,
  STATE,
  TRACK,
  TRACK_BITS,
} from "./layout.ts";

/** Decoded integers of a packet of n tracks over F frames. */
export interface Motion {
  /** Headers, shape (n, HEADER_FIELDS). All entries of a row are -1 if invalid bytes contain fewer tracks. */
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
  numFrames: number,
  firstNew: number,
): Motion {
  const coder = new RangeDecoder(payload),
    packetModels = models.slice(),
    headers = new Int32Array(HEADER_FIELDS * count).fill(-1),
    residuals = new Int32Array(count * NUM_CHANNELS * numFrames),
    numFound = readHeaders(coder, packetModels, headers, count, numFrames, firstNew),
    numCoefficients = Int32Array.from({ length: NUM_KINDS }, () => coder.below(numFrames + 1));
  let previous = -1;
  for (let i = 0; i < numFound; i++) {
    if (headers[HEADER_FIELDS * i + STATE] !== MOVING) continue;
    readTrack(coder, packetModels, residuals, i, previous, numCoefficients, numFrames);
    previous = i;
  }
  return { headers, residuals, numCoefficients };
}

function readHeaders(
  coder: RangeDecoder,
  models: Int32Array,
  headers: Int32Array,
  count: number,
  numFrames: number,
  firstNew: number,
): number {
  const first = coder.raw(TRACK_BITS),
    gapBefore = Math.min(coder.gamma(), 1 << 24),
    trackSpan = coder.raw(SPAN_BITS),
    gapAfter = Math.min(coder.gamma(), 1 << 24);
  let numFound = 0,
    gone = 0,
    lastStates = 0,
    before = first - gapBefore;
  for (let track = first; track < first + Math.min(trackSpan, MAX_TRACK_SPAN); track++) {
    gone = coder.bit(models, C_ABSENT + gone);
    if (gone) continue;
    if (numFound === count) break;
    const state = coder.bit(models, C_MOVING + lastStates);
    lastStates = ((lastStates << 1) | state) & 3;
    const begins = track >= firstNew && coder.bit(models, C_BEGINS) ? coder.below(numFrames) : 0,
      ends = coder.bit(models, C_ENDS) ? coder.below(numFrames) : numFrames,
      row = HEADER_FIELDS * numFound++;
    headers[row + TRACK] = track;
    headers[row + STATE] = state;
    headers[row + BEGINS] = begins;
    headers[row + ENDS] = ends;
    headers[row + GAP_BEFORE] = track - before;
    headers[row + GAP_AFTER] = 0;
    before = track + 1;
  }
  if (numFound) headers[HEADER_FIELDS * (numFound - 1) + GAP_AFTER] = gapAfter;
  return numFound;
}

/**
 * Decodes the residuals of one track. Contexts are the largest magnitude so far in the kind, and the channel before;
 * for the first coefficient of a kind, that of the moving track `previous` (its index; -1 if there is none).
 */
function readTrack(
  coder: RangeDecoder,
  models: Int32Array,
  residuals: Int32Array,
  i: number,
  previous: number,
  numCoefficients: Int32Array,
  numFrames: number,
): void {
  let largestOfKind = 0;
  for (let c = 0; c < NUM_CHANNELS; c++) {
    const kind = KIND_OF[c],
      isFirst = c === 0 || KIND_OF[c - 1] !== kind,
      at = (i * NUM_CHANNELS + c) * numFrames;
    let largestOfChannel = 0;
    if (isFirst) {
      largestOfKind = 0;
      if (previous >= 0) largestOfChannel = Math.abs(residuals[(previous * NUM_CHANNELS + c) * numFrames]);
    }
    for (let k = 0; k < numCoefficients[kind]; k++) {
      let expectedMagnitude = Math.max(largestOfChannel, largestOfKind);
      if (!isFirst) expectedMagnitude = Math.max(expectedMagnitude, 2 * Math.abs(residuals[at - numFrames + k]));
      const octave = expectedMagnitude < 2 ** 31 ? 32 - Math.clz32(expectedMagnitude) : NEIGHBOUR_CONTEXTS,
        neighbourContext = Math.min(octave, NEIGHBOUR_CONTEXTS - 1),
        value = readCoefficient(coder, models, kind, k, neighbourContext);
      residuals[at + k] = value;
      largestOfChannel = k === 0 && isFirst ? Math.abs(value) : Math.max(largestOfChannel, Math.abs(value));
    }
    largestOfKind = Math.max(largestOfKind, largestOfChannel);
  }
}

function readCoefficient(
  coder: RangeDecoder,
  models: Int32Array,
  kind: number,
  degree: number,
  neighbourContext: number,
): number {
  const degreeContext = kind * DEGREE_CONTEXTS + Math.min(degree, DEGREE_CONTEXTS - 1);
  if (!coder.bit(models, C_ZERO + degreeContext * NEIGHBOUR_CONTEXTS + neighbourContext)) return 0;
  const octaveContext = C_OCTAVE + (kind * NEIGHBOUR_CONTEXTS + neighbourContext) * OCTAVE_CONTEXTS;
  let octave = 0;
  while (octave < MAX_OCTAVE && coder.bit(models, octaveContext + Math.min(octave, OCTAVE_CONTEXTS - 1))) octave++;
  const magnitude = Math.min(2 ** octave + coder.raw(octave), MAX_QUANTISED);
  return coder.raw(1) ? -magnitude : magnitude;
}
