// Decoding of one packet. Any bytes decode to something: a hostile packet gives wrong Gaussians, never anything else.

import { RangeDecoder } from "../../entropy/decoder.ts";
import { Mixture } from "../../entropy/mixture.ts";
import { NUM_SCALES } from "../../entropy/tables.ts";
import { decodeCells } from "./cells.ts";
import { decodeHarmonics } from "./harmonics.ts";
import {
  AXIS,
  BITS,
  CLASS,
  COLUMNS,
  DIRECTION_BITS,
  FIRST_CLASS,
  LATTICE,
  LUMA,
  MAX_CELL_BITS,
  MAX_COLOUR,
  MAX_LOG,
  MAX_OPACITY,
  MAX_RESIDUAL,
  MAX_THIN,
  MIN_OPACITY,
  NARROW_WEIGHT,
  ONE,
  OPACITY,
  PRIMARY,
  S_COLOUR,
  S_DIRECTION,
  S_HARMONICS,
  S_OPACITY,
  S_POSITION,
  S_SCALE0,
  S_SCALE1,
  S_SCALE2,
  S_SPIN,
  SCALE0,
  SCALE1,
  SCALE2,
  SECONDS,
  SPIN,
  SPIN_BITS,
  SPREADS,
  WIDE,
} from "./layout.ts";
import { Neighbours, spreadContext } from "./neighbours.ts";
import type { SideInfo } from "./side_info.ts";
import { Steps } from "./steps.ts";
import { THINNESS } from "./tables.ts";

/** Decoded integers: `COLUMNS` of each Gaussian, and its harmonics. */
export interface Decoded {
  readonly rows: Float64Array;
  readonly harmonics: Int32Array;
}

/** Powers of two, for shifts of numbers that may have more than 32 bits. */
const POWER = Float64Array.from({ length: 64 }, (_, bits) => 2 ** bits);

const clip = (value: number, low: number, high: number): number => Math.min(Math.max(value, low), high);

/** Decodes packets of one stream, one after another. */
export class PacketDecoder {
  /** Of each context, those of means between two steps, in eighths from -4; made when they are needed. */
  readonly #mixtures: Mixture[][];
  /** Whether values are multiples of their steps, and not whole steps from what neighbours make expect. */
  readonly #absolute: boolean;
  /** log2 of the step of the value that was decoded last. */
  #shift = 0;
  readonly #steps: Steps;
  /** What the neighbours' mean axis is made of: the mean of each coordinate, and their mean deviation. */
  readonly #mean = new Float64Array(3);
  #deviation = 0;
  readonly #near = new Neighbours();
  readonly #models: Int32Array;
  #coder = new RangeDecoder(new Uint8Array());
  #rows = new Float64Array();
  /** How large the residuals of a Gaussian were so far, in sixteenths. */
  #running = 16;

  constructor(readonly info: SideInfo) {
    this.#absolute = info.coarsest >= 0;
    const byScale = new Map<number, Mixture[]>();
    this.#mixtures = Array.from(info.scales, (scale) => {
      const known = byScale.get(scale) ?? [];
      byScale.set(scale, known);
      return known;
    });
    this.#models = new Int32Array(info.models.length);
    this.#steps = new Steps(info.bases);
  }

  decode(payload: Uint8Array, block: number, count: number): Decoded {
    const { info } = this,
      coder = (this.#coder = new RangeDecoder(payload)),
      boxBits = info.boxes.bits[block];
    const rows = (this.#rows = new Float64Array(count * COLUMNS)),
      harmonics = new Int32Array(count * info.numHarmonics);
    this.#models.set(info.models);
    const at = Math.min(Math.max(coder.raw(6), boxBits - MAX_CELL_BITS), boxBits);
    const cells = new Int32Array(3 * count),
      defaults = info.defaults.subarray(7 * block, 7 * block + 7);
    decodeCells(coder, this.#models, cells, boxBits - at);
    for (let i = 0; i < count; i++) {
      this.#near.find(cells, i);
      this.#gaussian(i * COLUMNS, defaults, cells, 3 * i, at, boxBits);
      if (info.numHarmonics) {
        const level = rows[i * COLUMNS + CLASS],
          shift = clip(BITS - this.#steps.exponent(S_HARMONICS, level, 0, 0, 0, 0), 0, BITS - 2);
        decodeHarmonics(coder, this.#models, harmonics, i * info.numHarmonics, info.numHarmonics, level, shift);
      }
    }
    return { rows, harmonics };
  }

  #gaussian(row: number, defaults: Int32Array, cells: Int32Array, cell: number, at: number, boxBits: number): void {
    this.#running = 16;
    const rows = this.#rows,
      { unit } = this.info,
      level = (rows[row + CLASS] = this.#class());
    const opacity = clip(
      this.#value(0, S_OPACITY, OPACITY, defaults[0], level, 0, 0, 0, BITS),
      MIN_OPACITY,
      MAX_OPACITY,
    );
    rows[row + OPACITY] = opacity;
    const expected = this.#absolute ? 0 : 2 * this.#near.predict(rows, COLUMNS, SCALE0, defaults[1]) - (2 << BITS);
    const s0 = clip(
      this.#value(1, S_SCALE0, SCALE0, defaults[1], level, expected, 0, opacity, BITS - 1),
      -MAX_LOG,
      MAX_LOG,
    );
    rows[row + SCALE0] = s0;
    const long = clip(
      this.#value(2, S_SCALE1, SCALE1, defaults[2], level, 2 * s0 - (2 << BITS), 0, opacity, BITS - 1),
      0,
      MAX_LOG,
    );
    rows[row + SCALE1] = long;
    const area = 2 * s0 - long;
    const ratio = this.#value(3, S_SCALE2, SCALE2, defaults[3], level, area, long, opacity, BITS - 1);
    const companded = clip(ratio, 0, this.#absolute ? (MAX_THIN >> this.#shift) << this.#shift : MAX_THIN);
    rows[row + SCALE2] = companded;
    const thin = THINNESS[companded];
    const finest = Math.max(
      this.#steps.exponent(S_POSITION, level, area, long, thin, opacity),
      1 - ((s0 - long) >> BITS),
    );
    this.#place(
      row,
      cells,
      cell,
      at,
      Math.min(Math.max(unit - finest, 0), this.#absolute ? this.info.coarsest : boxBits),
    );
    const primary = (rows[row + PRIMARY] = thin >= long ? 2 : 0);
    const shift = clip(
      DIRECTION_BITS - this.#steps.exponent(S_DIRECTION, level, area, long, thin, opacity),
      0,
      DIRECTION_BITS - 2,
    );
    this.#axis(row, primary, shift);
    const bits = clip(this.#steps.exponent(S_SPIN, level, area, long, thin, opacity), 0, DIRECTION_BITS);
    rows[row + SPIN_BITS] = bits;
    rows[row + SPIN] = this.#coder.raw(bits);
    this.#colour(row, defaults, level);
  }

  #class(): number {
    const { count, who, weight } = this.#near;
    let total = 0,
      sums = 0,
      node = 1;
    for (let m = 0; m < count; m++) {
      total += weight[m];
      sums += weight[m] * this.#rows[who[m] * COLUMNS + CLASS];
    }
    const base = FIRST_CLASS + 8 * (count ? 1 + Math.floor((4 * sums + total) / (2 * total)) : 0);
    for (let bit = 0; bit < 3; bit++) node = 2 * node + this.#coder.bit(this.#models, base + node);
    return node - 8;
  }

  /** A value that is predicted by the neighbours' mean of its column. */
  #value(
    stream: number,
    step: number,
    column: number,
    otherwise: number,
    level: number,
    area: number,
    long: number,
    opacity: number,
    most: number,
  ): number {
    const near = this.#near,
      mean = near.predict(this.#rows, COLUMNS, column, otherwise);
    const shift = clip(BITS - this.#steps.exponent(step, level, area, long, 0, opacity), 0, most);
    return this.#coded(stream, spreadContext(near.count, near.deviation, shift), mean, shift);
  }

  /** A value that is expected to be `mean`: a multiple of the step, or whole steps from the mean. */
  #coded(stream: number, spread: number, mean: number, shift: number): number {
    const step = POWER[(this.#shift = shift)];
    if (!this.#absolute) return mean + this.#residual(stream, spread, shift, 0) * step;
    const eighths = Math.floor((8 * mean + Math.floor(step / 2)) / step),
      near = Math.floor((eighths + 4) / 8);
    return (near + this.#residual(stream, spread, shift, eighths - 8 * near)) * step;
  }

  /**
   * A residual in steps, of a mean in eighths; a context of all but the first two streams is how large those before
   * were.
   */
  #residual(stream: number, spread: number, shift: number, mean: number): number {
    const second = stream < 2 ? shift : Math.min(32 - Math.clz32(this.#running), SECONDS - 1),
      context = (stream * SPREADS + spread) * SECONDS + second;
    const scale = this.info.scales[context],
      kinds = this.#mixtures[context];
    const mixture = (kinds[mean + 4] ??= new Mixture(
      mean * 512,
      scale,
      Math.min(scale + WIDE, NUM_SCALES - 1),
      NARROW_WEIGHT,
    ));
    const q = clip(mixture.decode(this.#coder), -MAX_RESIDUAL, MAX_RESIDUAL);
    this.#running = (this.#running + 16 * Math.min(Math.abs(q), 1 << 14)) >> 1;
    return q;
  }

  /** The bits of a place between cell and step; coordinates are in half lattice units. */
  #place(row: number, cells: Int32Array, cell: number, at: number, shift: number): void {
    const low = Math.min(at, shift),
      fine = at - low,
      size = this.#absolute ? shift : low;
    const wider = POWER[size - low],
      unit = POWER[size + 1],
      half = POWER[size];
    for (let a = 0; a < 3; a++) {
      const place = fine ? cells[cell + a] * POWER[fine] + this.#coder.raw(fine) : cells[cell + a];
      this.#rows[row + LATTICE + a] = Math.floor(place / wider) * unit + half;
    }
  }

  /**
   * The primary axis, as seen from the coordinate axis nearest to the neighbours' mean axis: two coordinates, or a
   * place on an octahedral square.
   */
  #axis(row: number, primary: number, shift: number): void {
    const rows = this.#rows,
      mean = this.#mean,
      same = this.#meanAxis(primary);
    let pole = 0;
    for (let a = 1; a < 3; a++) if (Math.abs(mean[a]) > Math.abs(mean[pole])) pole = a;
    const side = mean[pole] < 0 ? -1 : 1,
      first = (pole + 1) % 3,
      second = (pole + 2) % 3;
    const norm = Math.abs(mean[0]) + Math.abs(mean[1]) + Math.abs(mean[2]),
      p = side * mean[first],
      q = side * mean[second];
    const spread = spreadContext(same, this.#deviation, shift),
      square = this.#absolute ? 0 : 1;
    const e0 = clip(this.#coded(4, spread, Math.floor(((p + square * q) * ONE) / norm), shift), -ONE, ONE),
      most = square ? ONE : ONE - Math.abs(e0);
    const e1 = clip(
      this.#coded(4, spread, Math.floor(((square * p - q) * (square ? 1 : -1) * ONE) / norm), shift),
      -most,
      most,
    );
    const x = square ? (e0 + e1) >> 1 : e0,
      y = square ? (e0 - e1) >> 1 : e1;
    rows[row + AXIS + first] = x;
    rows[row + AXIS + second] = y + 0; // no negative zero
    rows[row + AXIS + pole] = Math.max(ONE - Math.abs(x) - Math.abs(y), 0);
    if (!square) this.#turn(row + AXIS);
  }

  /** Its largest coordinate, the first of them, becomes positive: then the axis is the same in every packet. */
  #turn(u: number): void {
    const rows = this.#rows;
    let pole = 0;
    for (let a = 1; a < 3; a++) if (Math.abs(rows[u + a]) > Math.abs(rows[u + pole])) pole = a;
    if (rows[u + pole] < 0) for (let a = 0; a < 3; a++) rows[u + a] = 0 - rows[u + a];
  }

  /**
   * Weighted sum of the neighbours' axes of the same kind, on the nearest one's side; gives how many, sets their mean
   * deviation.
   */
  #meanAxis(primary: number): number {
    const rows = this.#rows,
      { count, who, weight } = this.#near,
      mean = this.#mean;
    let nearest = -1,
      total = 0,
      same = 0,
      deviations = 0,
      x = 0,
      y = 0,
      z = 0;
    for (let m = 0; m < count; m++) {
      const row = who[m] * COLUMNS,
        u = row + AXIS;
      if (rows[row + PRIMARY] !== primary) continue;
      if (nearest < 0) nearest = u;
      const dot = rows[u] * rows[nearest] + rows[u + 1] * rows[nearest + 1] + rows[u + 2] * rows[nearest + 2];
      const w = dot >= 0 ? weight[m] : -weight[m];
      x += w * rows[u];
      y += w * rows[u + 1];
      z += w * rows[u + 2];
      total += weight[m];
      same++;
    }
    this.#deviation = mean[0] = mean[1] = 0;
    mean[2] = ONE;
    if (nearest < 0 || !(x || y || z)) return 0;
    const mx = Math.floor(x / total),
      my = Math.floor(y / total),
      mz = Math.floor(z / total);
    for (let m = 0; m < count; m++) {
      const row = who[m] * COLUMNS,
        u = row + AXIS;
      if (rows[row + PRIMARY] !== primary) continue;
      const near = Math.abs(rows[u] - mx) + Math.abs(rows[u + 1] - my) + Math.abs(rows[u + 2] - mz);
      const opposite = Math.abs(rows[u] + mx) + Math.abs(rows[u + 1] + my) + Math.abs(rows[u + 2] + mz);
      deviations += weight[m] * Math.min(near, opposite);
    }
    mean[0] = x;
    mean[1] = y;
    mean[2] = z;
    this.#deviation = Math.floor(deviations / total);
    return same;
  }

  /** Luma and chroma. */
  #colour(row: number, defaults: Int32Array, level: number): void {
    const near = this.#near,
      shift = clip(BITS - this.#steps.exponent(S_COLOUR, level, 0, 0, 0, 0), 0, BITS - 2);
    for (let c = 0; c < 3; c++) {
      const mean = near.predict(this.#rows, COLUMNS, LUMA + c, defaults[4 + c]);
      const value = this.#coded(5 + c, spreadContext(near.count, near.deviation, shift), mean, shift);
      this.#rows[row + LUMA + c] = clip(value, -MAX_COLOUR, MAX_COLOUR);
    }
  }
}
