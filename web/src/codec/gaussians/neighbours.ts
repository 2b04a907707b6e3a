// Prediction of a Gaussian from its nearest predecessors in the packet.

import {
  AXIS,
  CLASS,
  COLUMNS,
  LUMA,
  MAX_SQUARED_DISTANCE,
  NUM_DEVIATION_CONTEXTS,
  NUM_NEIGHBOURS,
  ONE,
  OPACITY,
  WINDOW,
} from "./layout.ts";

/** Maximum bits of a cell's coordinate, so that a squared distance and an index of the window fit in 32 bits. */
const NARROW_BITS = 11,
  AGE_BITS = 6,
  NUM_GROUPS = 8,
  MAX_KEY = 0x7fffffff;
/** Attributes that are predicted as means: opacity, three of scales, Y Co Cg, and the class. */
const PREDICTED = 8,
  CLASS_VALUE = 7;
/** Index of the prediction of luma among `means`; those of chroma follow. Before it are opacity and scales. */
export const LUMA_VALUE = 4;

/** Neighbours of one Gaussian after another of a packet, and the predictions by them. */
export class Neighbours {
  count = 0;
  /** Rows of the neighbours, nearest first, and their weights. */
  readonly #indices = new Int32Array(NUM_NEIGHBOURS);
  readonly #weights = new Float64Array(NUM_NEIGHBOURS);
  /** Weighted means of the neighbours' attributes, and their mean deviations from these. */
  readonly means = new Int32Array(PREDICTED);
  readonly deviations = new Int32Array(PREDICTED);
  /** Weighted sum of the neighbours' axes, their mean deviation, and their number. */
  readonly axis = new Float64Array(3);
  axisDeviation = 0;
  axisCount = 0;
  readonly #keys = new Int32Array(WINDOW);
  readonly #groupMinima = new Int32Array(NUM_GROUPS);
  /** Attributes of the packet's Gaussians, and their axes, each with the index of the primary axis. */
  #values = new Float64Array();
  #axes = new Int32Array();
  #cells: Int32Array = new Int32Array();
  #narrow = true;

  /** Begins a packet with the given cells of `depth` bits per axis. */
  begin(cells: Int32Array, depth: number): void {
    const count = cells.length / 3;
    this.#cells = cells;
    this.#narrow = depth <= NARROW_BITS;
    if (this.#values.length >= PREDICTED * count) return;
    this.#values = new Float64Array(PREDICTED * count);
    this.#axes = new Int32Array(4 * count);
  }

  /** Finds the neighbours of Gaussian `i`. Of two at equal distance, the later one counts as nearer. */
  find(i: number): void {
    this.count = Math.min(i, NUM_NEIGHBOURS);
    if (this.#narrow) this.#findNarrow(i);
    else this.#findWide(i);
  }

  /**
   * Finds neighbours by keys: squared distance times 64 plus age. The sixth smallest of the least keys of eight groups
   * is an upper bound of the sixth smallest key. Only the few keys up to this bound are sorted.
   */
  #findNarrow(i: number): void {
    const keys = this.#keys,
      groupMinima = this.#groupMinima,
      cells = this.#cells,
      n = Math.min(i, WINDOW),
      x = cells[3 * i],
      y = cells[3 * i + 1],
      z = cells[3 * i + 2];
    groupMinima.fill(MAX_KEY);
    for (let k = 0, at = 3 * (i - 1); k < n; k++, at -= 3) {
      const a = (x - cells[at]) | 0,
        b = (y - cells[at + 1]) | 0,
        c = (z - cells[at + 2]) | 0,
        key = ((Math.imul(a, a) + Math.imul(b, b) + Math.imul(c, c)) << AGE_BITS) | k,
        group = k & (NUM_GROUPS - 1);
      keys[k] = key;
      if (key < groupMinima[group]) groupMinima[group] = key;
    }
    // the third largest of eight is the sixth smallest
    let largest = -1,
      second = -1,
      bound = -1;
    for (let group = 0; group < NUM_GROUPS; group++) {
      const key = groupMinima[group];
      if (key > largest) {
        bound = second;
        second = largest;
        largest = key;
      } else if (key > second) {
        bound = second;
        second = key;
      } else if (key > bound) bound = key;
    }
    const indices = this.#indices,
      weights = this.#weights;
    let found = 0;
    for (let k = 0; k < n; k++) {
      const key = keys[k];
      if (key > bound || (found === NUM_NEIGHBOURS && key > indices[found - 1])) continue;
      let at = found < NUM_NEIGHBOURS ? found++ : found - 1;
      for (; at > 0 && indices[at - 1] > key; at--) indices[at] = indices[at - 1];
      indices[at] = key;
    }
    const nearest = ((indices[0] >> AGE_BITS) + 1) * 4096;
    for (let m = 0; m < found; m++) {
      const key = indices[m];
      weights[m] = Math.floor(nearest / ((key >> AGE_BITS) + 1));
      indices[m] = i - 1 - (key & (WINDOW - 1));
    }
  }

  /** Finds neighbours by insertion, for cells of any size. */
  #findWide(i: number): void {
    const far = this.#weights,
      indices = this.#indices,
      cells = this.#cells,
      cx = cells[3 * i],
      cy = cells[3 * i + 1],
      cz = cells[3 * i + 2];
    let count = 0;
    for (let j = i - 1, last = Math.max(i - WINDOW, 0); j >= last; j--) {
      const x = cx - cells[3 * j],
        y = cy - cells[3 * j + 1],
        z = cz - cells[3 * j + 2],
        d = Math.min(x * x + y * y + z * z, MAX_SQUARED_DISTANCE);
      if (count === NUM_NEIGHBOURS && d >= far[count - 1]) continue;
      let at = count < NUM_NEIGHBOURS ? count++ : count - 1;
      for (; at > 0 && far[at - 1] > d; at--) {
        far[at] = far[at - 1];
        indices[at] = indices[at - 1];
      }
      far[at] = d;
      indices[at] = j;
    }
    const nearest = (far[0] + 1) * 4096;
    for (let m = 0; m < count; m++) far[m] = Math.floor(nearest / (far[m] + 1));
  }

  /**
   * Sets `means` and `deviations`, from the block's means `blockMeans` without neighbours. Returns the context of the
   * class: 0 without neighbours, otherwise 1 plus the neighbours' mean class in halves.
   */
  predict(blockMeans: Int32Array): number {
    const { count, means, deviations } = this,
      indices = this.#indices,
      weights = this.#weights,
      values = this.#values;
    if (count === 0) {
      means.set(blockMeans);
      deviations.fill(0);
      return 0;
    }
    let total = 0,
      a = 0,
      b = 0,
      c = 0,
      d = 0,
      e = 0,
      f = 0,
      g = 0,
      level = 0;
    for (let m = 0; m < count; m++) {
      const w = weights[m],
        at = PREDICTED * indices[m];
      total += w;
      a += w * values[at];
      b += w * values[at + 1];
      c += w * values[at + 2];
      d += w * values[at + 3];
      e += w * values[at + 4];
      f += w * values[at + 5];
      g += w * values[at + 6];
      level += w * values[at + CLASS_VALUE];
    }
    a = Math.floor(a / total);
    b = Math.floor(b / total);
    c = Math.floor(c / total);
    d = Math.floor(d / total);
    e = Math.floor(e / total);
    f = Math.floor(f / total);
    g = Math.floor(g / total);
    means[0] = a;
    means[1] = b;
    means[2] = c;
    means[3] = d;
    means[4] = e;
    means[5] = f;
    means[6] = g;
    let aa = 0,
      bb = 0,
      cc = 0,
      dd = 0,
      ee = 0,
      ff = 0,
      gg = 0;
    for (let m = 0; m < count; m++) {
      const w = weights[m],
        at = PREDICTED * indices[m];
      aa += w * Math.abs(values[at] - a);
      bb += w * Math.abs(values[at + 1] - b);
      cc += w * Math.abs(values[at + 2] - c);
      dd += w * Math.abs(values[at + 3] - d);
      ee += w * Math.abs(values[at + 4] - e);
      ff += w * Math.abs(values[at + 5] - f);
      gg += w * Math.abs(values[at + 6] - g);
    }
    // the conversion to integers rounds down
    deviations[0] = aa / total;
    deviations[1] = bb / total;
    deviations[2] = cc / total;
    deviations[3] = dd / total;
    deviations[4] = ee / total;
    deviations[5] = ff / total;
    deviations[6] = gg / total;
    return 1 + Math.floor((4 * level + total) / (2 * total));
  }

  /**
   * Sets `axis` to the weighted sum of the neighbours' axes of the same kind, each flipped towards the nearest one's,
   * `axisDeviation` to their mean deviation, and `axisCount` to their number.
   */
  predictAxis(primary: number): void {
    const { count, axis } = this,
      indices = this.#indices,
      weights = this.#weights,
      axes = this.#axes;
    let total = 0,
      same = 0,
      nearest = 0,
      x = 0,
      y = 0,
      z = 0;
    for (let m = 0; m < count; m++) {
      const u = 4 * indices[m];
      if (axes[u + 3] !== primary) continue;
      if (same++ === 0) nearest = u;
      const ax = axes[u],
        ay = axes[u + 1],
        az = axes[u + 2],
        weight = weights[m],
        w = ax * axes[nearest] + ay * axes[nearest + 1] + az * axes[nearest + 2] >= 0 ? weight : -weight;
      x += w * ax;
      y += w * ay;
      z += w * az;
      total += weight;
    }
    this.axisDeviation = this.axisCount = axis[0] = axis[1] = 0;
    axis[2] = ONE;
    if (!same || !(x || y || z)) return;
    const mx = Math.floor(x / total),
      my = Math.floor(y / total),
      mz = Math.floor(z / total);
    let deviations = 0;
    for (let m = 0; m < count; m++) {
      const u = 4 * indices[m];
      if (axes[u + 3] !== primary) continue;
      const ax = axes[u],
        ay = axes[u + 1],
        az = axes[u + 2];
      deviations +=
        weights[m] *
        Math.min(
          Math.abs(ax - mx) + Math.abs(ay - my) + Math.abs(az - mz),
          Math.abs(ax + mx) + Math.abs(ay + my) + Math.abs(az + mz),
        );
    }
    axis[0] = x;
    axis[1] = y;
    axis[2] = z;
    this.axisDeviation = Math.floor(deviations / total);
    this.axisCount = same;
  }

  /** Stores the decoded Gaussian `i` for the prediction of later ones. */
  storeValues(rows: Float64Array, i: number): void {
    const row = COLUMNS * i,
      values = this.#values,
      axes = this.#axes,
      at = PREDICTED * i,
      u = 4 * i;
    for (let c = 0; c < LUMA_VALUE; c++) values[at + c] = rows[row + OPACITY + c];
    for (let c = 0; c < 3; c++) values[at + LUMA_VALUE + c] = rows[row + LUMA + c];
    values[at + CLASS_VALUE] = rows[row + CLASS];
    for (let c = 0; c < 4; c++) axes[u + c] = rows[row + AXIS + c]; // the primary axis' index follows its coordinates
  }
}

/** Returns the context of a residual: no neighbours, fewer than three, or the octave of their deviation in steps. */
export function deviationContextOf(count: number, deviation: number, shift: number): number {
  if (count < 3) return count === 0 ? 0 : 1;
  return 2 + Math.min(32 - Math.clz32((deviation * 8) >> shift), NUM_DEVIATION_CONTEXTS - 3);
}
