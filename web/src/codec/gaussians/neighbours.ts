// The nearest of the Gaussians just before one, and what they say of it.

import { FAR, NUM_NEIGHBOURS, SPREADS, WINDOW } from "./layout.ts";

export class Neighbours {
  count = 0;
  /** Their rows, nearest first. */
  readonly who = new Int32Array(NUM_NEIGHBOURS);
  readonly weight = new Int32Array(NUM_NEIGHBOURS);
  /** Weighted mean deviation of the value that was predicted last. */
  deviation = 0;
  readonly #far = new Float64Array(NUM_NEIGHBOURS);

  find(cells: Int32Array, i: number): void {
    const far = this.#far,
      who = this.who,
      cx = cells[3 * i],
      cy = cells[3 * i + 1],
      cz = cells[3 * i + 2];
    let count = 0;
    for (let j = i - 1, last = Math.max(i - WINDOW, 0); j >= last; j--) {
      const x = cx - cells[3 * j],
        y = cy - cells[3 * j + 1],
        z = cz - cells[3 * j + 2],
        d = Math.min(x * x + y * y + z * z, FAR);
      if (count === NUM_NEIGHBOURS && d >= far[count - 1]) continue;
      let at = count < NUM_NEIGHBOURS ? count++ : count - 1;
      for (; at > 0 && far[at - 1] > d; at--) {
        far[at] = far[at - 1];
        who[at] = who[at - 1];
      }
      far[at] = d;
      who[at] = j;
    }
    for (let m = 0; m < count; m++) this.weight[m] = Math.floor(((far[0] + 1) * 4096) / (far[m] + 1));
    this.count = count;
  }

  /** Weighted mean of a column, rounded down; sets `deviation`. */
  predict(rows: Float64Array, columns: number, column: number, otherwise: number): number {
    const { count, who, weight } = this;
    this.deviation = 0;
    if (count === 0) return otherwise;
    let total = 0,
      sums = 0,
      deviations = 0;
    for (let m = 0; m < count; m++) {
      total += weight[m];
      sums += weight[m] * rows[who[m] * columns + column];
    }
    const mean = Math.floor(sums / total);
    for (let m = 0; m < count; m++) deviations += weight[m] * Math.abs(rows[who[m] * columns + column] - mean);
    this.deviation = Math.floor(deviations / total);
    return mean;
  }
}

/** Context of a residual: no neighbour, too few, or how much they differ in steps, in octaves. */
export function spreadContext(count: number, deviation: number, shift: number): number {
  if (count < 3) return count === 0 ? 0 : 1;
  return 2 + Math.min(32 - Math.clz32((deviation * 8) >> shift), SPREADS - 3);
}
