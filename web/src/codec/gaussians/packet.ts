// Packet decoder for Gaussians. Any bytes decode to some Gaussians, so hostile packets do no other harm.

import { RangeDecoder } from "../../entropy/decoder.ts";
import { Mixture } from "../../entropy/mixture.ts";
import { NUM_SCALES } from "../../entropy/tables.ts";
import type { Splats } from "../splats.ts";
import { decodeCells } from "./cells.ts";
import { decodeHarmonics } from "./harmonics.ts";
import {
  ASSUMED_ELONGATION,
  AXIS,
  BITS,
  CLASS,
  COLUMNS,
  DIRECTION_BITS,
  ELONGATION,
  FIRST_CLASS,
  FLATNESS,
  LUMA,
  MAX_CELL_BITS,
  MAX_COLOUR,
  MAX_COMPANDED,
  MAX_LOG,
  MAX_LOG_OPACITY,
  MAX_RESIDUAL,
  MIN_LOG_OPACITY,
  NARROW_WEIGHT,
  NUM_DEVIATION_CONTEXTS,
  NUM_MAGNITUDE_CONTEXTS,
  ONE,
  OPACITY,
  POSITION,
  PRIMARY,
  SCALE0,
  SPIN,
  SPIN_BITS,
  STEP_COLOUR,
  STEP_DIRECTION,
  STEP_ELONGATION,
  STEP_FLATNESS,
  STEP_HARMONICS,
  STEP_OPACITY,
  STEP_POSITION,
  STEP_SCALE0,
  STEP_SPIN,
  WIDE_SCALE_OFFSET,
} from "./layout.ts";
import { deviationContextOf, LUMA_VALUE, Neighbours } from "./neighbours.ts";
import type { SideInfo } from "./side_info.ts";
import { Steps } from "./steps.ts";
import { flatnessTable } from "./tables.ts";

/** Decoded integers: `COLUMNS` numbers per Gaussian, and its harmonics. */
export interface Decoded {
  /** Empty if the numbers are in `integers`. */
  readonly rows: Float64Array;
  readonly harmonics: Int32Array;
  /** The numbers of the rows as little-endian 64-bit integers; undefined if `rows` contains the numbers. */
  readonly integers?: Uint8Array | undefined;
  /** The Gaussians made of the integers, if the decoder has them anyway. */
  readonly splats?: Splats;
}

/** Number of different means, in eighths of a step. */
const NUM_MEANS = 8;

/** Powers of two, for shifts of numbers above 32 bits. */
const POWER = Float64Array.from({ length: 64 }, (_, bits) => 2 ** bits);

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);

/** Decodes the packets of one stream. */
export interface GaussianPacketDecoder {
  /**
   * Decodes the payload of a packet of `count` Gaussians. Any bytes decode to some integers. If `mayReuse`, the next
   * call may overwrite the result. If `asRows`, the result has `rows`, not `integers`; this is the default unless
   * `mayReuse`.
   */
  decode(payload: Uint8Array, block: number, count: number, mayReuse?: boolean, asRows?: boolean): Decoded;
}

/** Decodes packets without WebAssembly. */
export class PacketDecoder implements GaussianPacketDecoder {
  /** Distributions by context, for means in eighths of a step from -4. Created on demand. */
  readonly #mixtures: (Mixture | undefined)[];
  /** Distributions by scale and mean, which contexts share. */
  readonly #byScale: (Mixture | undefined)[] = [];
  /** True if values are multiples of their steps, false if coded relative to the prediction. */
  readonly #absolute: boolean;
  /** log2 of the step of the value decoded last. */
  #shift = 0;
  readonly #steps: Steps;
  readonly #neighbours = new Neighbours();
  readonly #models: Int32Array;
  #coder = new RangeDecoder(new Uint8Array());
  #rows = new Float64Array();
  /** Running magnitude of a Gaussian's residuals, in sixteenths. */
  #residualMagnitude = 16;

  constructor(readonly info: SideInfo) {
    this.#absolute = info.maxPositionShift >= 0;
    this.#mixtures = Array.from({ length: NUM_MEANS * info.scaleIndices.length }, () => undefined);
    this.#models = new Int32Array(info.models.length);
    this.#steps = new Steps(info.baseExponents);
  }

  decode(payload: Uint8Array, block: number, count: number): Decoded {
    const { info } = this,
      coder = (this.#coder = new RangeDecoder(payload)),
      boxBits = info.boxes.bits[block];
    const rows = (this.#rows = new Float64Array(count * COLUMNS)),
      harmonics = new Int32Array(count * info.numHarmonicColumns);
    this.#models.set(info.models);
    const cellShift = Math.min(Math.max(coder.raw(6), boxBits - MAX_CELL_BITS), boxBits);
    const cells = new Int32Array(3 * count),
      blockMeans = info.blockMeans.subarray(7 * block, 7 * block + 7);
    decodeCells(coder, this.#models, cells, boxBits - cellShift);
    this.#neighbours.begin(cells, boxBits - cellShift);
    for (let i = 0; i < count; i++) {
      this.#neighbours.find(i);
      this.#decodeGaussian(i * COLUMNS, this.#neighbours.predict(blockMeans), cells, 3 * i, cellShift, boxBits);
      this.#neighbours.storeValues(rows, i);
      if (info.numHarmonicColumns) {
        const precisionClass = rows[i * COLUMNS + CLASS],
          shift = clip(BITS - this.#steps.exponent(STEP_HARMONICS, precisionClass, 0, 0, 0, 0), 0, BITS - 2);
        decodeHarmonics(
          coder,
          this.#models,
          harmonics,
          i * info.numHarmonicColumns,
          info.numHarmonicColumns,
          precisionClass,
          shift,
        );
      }
    }
    return { rows, harmonics };
  }

  #decodeGaussian(
    row: number,
    classContext: number,
    cells: Int32Array,
    cell: number,
    cellShift: number,
    boxBits: number,
  ): void {
    this.#residualMagnitude = 16;
    const rows = this.#rows,
      { latticeBits } = this.info,
      precisionClass = (rows[row + CLASS] = this.#decodeClass(classContext));
    const opacity = clip(
      this.#decodePredicted(0, STEP_OPACITY, precisionClass, 0, 0, 0, BITS),
      MIN_LOG_OPACITY,
      MAX_LOG_OPACITY,
    );
    rows[row + OPACITY] = opacity;
    const expected = this.#absolute ? 0 : 2 * this.#neighbours.means[1] - ASSUMED_ELONGATION;
    const s0 = clip(
      this.#decodePredicted(1, STEP_SCALE0, precisionClass, expected, 0, opacity, BITS - 1),
      -MAX_LOG,
      MAX_LOG,
    );
    rows[row + SCALE0] = s0;
    const elongation = clip(
      this.#decodePredicted(2, STEP_ELONGATION, precisionClass, 2 * s0 - ASSUMED_ELONGATION, 0, opacity, BITS - 1),
      0,
      MAX_LOG,
    );
    rows[row + ELONGATION] = elongation;
    const area = 2 * s0 - elongation;
    const ratio = this.#decodePredicted(3, STEP_FLATNESS, precisionClass, area, elongation, opacity, BITS - 1);
    const companded = clip(ratio, 0, this.#absolute ? (MAX_COMPANDED >> this.#shift) << this.#shift : MAX_COMPANDED);
    rows[row + FLATNESS] = companded;
    const flatness = flatnessTable()[companded];
    const finest = Math.max(
      this.#steps.exponent(STEP_POSITION, precisionClass, area, elongation, flatness, opacity),
      1 - ((s0 - elongation) >> BITS),
    );
    this.#decodePosition(
      row,
      cells,
      cell,
      cellShift,
      Math.min(Math.max(latticeBits - finest, 0), this.#absolute ? this.info.maxPositionShift : boxBits),
    );
    const primary = (rows[row + PRIMARY] = flatness >= elongation ? 2 : 0);
    const shift = clip(
      DIRECTION_BITS - this.#steps.exponent(STEP_DIRECTION, precisionClass, area, elongation, flatness, opacity),
      0,
      DIRECTION_BITS - 2,
    );
    this.#decodeAxis(row, primary, shift);
    const bits = clip(
      this.#steps.exponent(STEP_SPIN, precisionClass, area, elongation, flatness, opacity),
      0,
      DIRECTION_BITS,
    );
    rows[row + SPIN_BITS] = bits;
    rows[row + SPIN] = this.#coder.raw(bits);
    this.#decodeColour(row, precisionClass);
  }

  #decodeClass(context: number): number {
    const base = FIRST_CLASS + 8 * context;
    let node = 1;
    for (let bit = 0; bit < 3; bit++) node = 2 * node + this.#coder.bit(this.#models, base + node);
    return node - 8;
  }

  /** Decodes a value that is predicted by the neighbours' mean. `kind` is also the index of this mean. */
  #decodePredicted(
    kind: number,
    step: number,
    precisionClass: number,
    area: number,
    elongation: number,
    opacity: number,
    maxShift: number,
  ): number {
    const { count, means, deviations } = this.#neighbours;
    const shift = clip(BITS - this.#steps.exponent(step, precisionClass, area, elongation, 0, opacity), 0, maxShift);
    return this.#decodeValue(kind, deviationContextOf(count, deviations[kind], shift), means[kind], shift);
  }

  /** Decodes a value with prediction `mean`: a multiple of the step, or whole steps from the mean. */
  #decodeValue(kind: number, deviationContext: number, mean: number, shift: number): number {
    this.#shift = shift;
    if (!this.#absolute) return mean + this.#decodeResidual(kind, deviationContext, shift, 0) * (1 << shift);
    const eighths = (8 * mean + ((1 << shift) >> 1)) >> shift,
      meanSteps = (eighths + 4) >> 3;
    return (meanSteps + this.#decodeResidual(kind, deviationContext, shift, eighths - 8 * meanSteps)) * (1 << shift);
  }

  /**
   * Decodes a residual in steps. `mean` is in eighths. The context of the first two kinds includes the step, that of
   * others the size of earlier residuals.
   */
  #decodeResidual(kind: number, deviationContext: number, shift: number, mean: number): number {
    const magnitude = this.#residualMagnitude,
      magnitudeContext = kind < 2 ? shift : Math.min(32 - Math.clz32(magnitude), NUM_MAGNITUDE_CONTEXTS - 1),
      context = (kind * NUM_DEVIATION_CONTEXTS + deviationContext) * NUM_MAGNITUDE_CONTEXTS + magnitudeContext;
    const mixture = this.#mixtures[NUM_MEANS * context + mean + 4] ?? this.#mixtureOf(context, mean);
    const residual = clip(mixture.decode(this.#coder), -MAX_RESIDUAL, MAX_RESIDUAL);
    this.#residualMagnitude = (magnitude + 16 * Math.min(Math.abs(residual), 1 << 14)) >> 1;
    return residual;
  }

  #mixtureOf(context: number, mean: number): Mixture {
    const scale = this.info.scaleIndices[context],
      mixture = (this.#byScale[NUM_MEANS * scale + mean + 4] ??= new Mixture(
        mean * 512,
        scale,
        Math.min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1),
        NARROW_WEIGHT,
      ));
    return (this.#mixtures[NUM_MEANS * context + mean + 4] = mixture);
  }

  /** Decodes the bits of a position between cell and step. Coordinates are in half lattice units. */
  #decodePosition(row: number, cells: Int32Array, cell: number, cellShift: number, shift: number): void {
    const low = Math.min(cellShift, shift),
      fine = cellShift - low,
      size = this.#absolute ? shift : low;
    const wider = POWER[size - low],
      unit = POWER[size + 1],
      half = POWER[size];
    for (let a = 0; a < 3; a++) {
      const position = fine ? cells[cell + a] * POWER[fine] + this.#coder.raw(fine) : cells[cell + a];
      this.#rows[row + POSITION + a] = Math.floor(position / wider) * unit + half;
    }
  }

  /**
   * Decodes the primary axis of a Gaussian. Two of its coordinates are coded, directly or as their sum and difference
   * (octahedral map). The third one follows from them; it is the largest coordinate of the neighbours' mean axis.
   */
  #decodeAxis(row: number, primary: number, shift: number): void {
    const rows = this.#rows,
      near = this.#neighbours,
      mean = near.axis;
    near.predictAxis(primary);
    let pole = 0;
    for (let a = 1; a < 3; a++) if (Math.abs(mean[a]) > Math.abs(mean[pole])) pole = a;
    const side = mean[pole] < 0 ? -1 : 1,
      first = (pole + 1) % 3,
      second = (pole + 2) % 3;
    const norm = Math.abs(mean[0]) + Math.abs(mean[1]) + Math.abs(mean[2]),
      p = side * mean[first],
      q = side * mean[second];
    const deviationContext = deviationContextOf(near.axisCount, near.axisDeviation, shift),
      isSumDifference = !this.#absolute,
      expected0 = isSumDifference ? p + q : p,
      expected1 = isSumDifference ? p - q : q;
    const e0 = clip(this.#decodeValue(4, deviationContext, Math.floor((expected0 * ONE) / norm), shift), -ONE, ONE),
      limit = isSumDifference ? ONE : ONE - Math.abs(e0);
    const e1 = clip(this.#decodeValue(4, deviationContext, Math.floor((expected1 * ONE) / norm), shift), -limit, limit);
    const x = isSumDifference ? (e0 + e1) >> 1 : e0,
      y = isSumDifference ? (e0 - e1) >> 1 : e1;
    rows[row + AXIS + first] = x;
    rows[row + AXIS + second] = y + 0; // avoids negative zero
    rows[row + AXIS + pole] = Math.max(ONE - Math.abs(x) - Math.abs(y), 0);
    if (!isSumDifference) this.#canonicaliseAxis(row + AXIS);
  }

  /** Flips an axis so that its largest coordinate is positive. The axis then does not depend on the packet. */
  #canonicaliseAxis(u: number): void {
    const rows = this.#rows;
    let pole = 0;
    for (let a = 1; a < 3; a++) if (Math.abs(rows[u + a]) > Math.abs(rows[u + pole])) pole = a;
    if (rows[u + pole] < 0) for (let a = 0; a < 3; a++) rows[u + a] = 0 - rows[u + a];
  }

  /** Decodes luma and chroma. */
  #decodeColour(row: number, precisionClass: number): void {
    const { count, means, deviations } = this.#neighbours,
      shift = clip(BITS - this.#steps.exponent(STEP_COLOUR, precisionClass, 0, 0, 0, 0), 0, BITS - 2);
    for (let c = 0; c < 3; c++) {
      const deviationContext = deviationContextOf(count, deviations[LUMA_VALUE + c], shift),
        value = this.#decodeValue(5 + c, deviationContext, means[LUMA_VALUE + c], shift);
      this.#rows[row + LUMA + c] = clip(value, -MAX_COLOUR, MAX_COLOUR);
    }
  }
}
