// Weights of neighbours in a smooth fit. Counterpart of `splatwire.concealment.temporal.neighbors.smooth_weights`.

const MIN_DISTANCE = 0.1,
  TERMS = 10,
  RIDGES = [1e-9, 1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2, 1e-2],
  /** Largest sum of absolute weights. Beyond it the fit extrapolates too far, and the weighted mean is used. */
  MAX_WEIGHT_SUM = 6,
  /** Neighbours summed in parallel by independent accumulators. */
  LANES = 4;

/** Powers of x, y and z in each term. */
const POWERS_OF = ["", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz"];

/**
 * Distinct products of two terms, and the index of the product of terms a and b. Equal products such as x * y and xy *
 * 1 are stored once.
 */
const PRODUCTS: [number, number][] = [],
  PRODUCT_AT = new Uint8Array(TERMS * TERMS);
{
  const known = new Map<string, number>();
  for (let a = 0; a < TERMS; a++) {
    for (let b = 0; b <= a; b++) {
      const name = [...(POWERS_OF[a] + POWERS_OF[b])].sort().join("");
      if (!known.has(name)) known.set(name, PRODUCTS.push([a, b]) - 1);
      PRODUCT_AT[TERMS * a + b] = known.get(name) as number;
    }
  }
}
const FIRSTS = Uint8Array.from(PRODUCTS, ([a]) => a),
  SECONDS = Uint8Array.from(PRODUCTS, ([, b]) => b);

/** Computes weights that decrease with distance and sum to 1. Returns the root mean square distance. */
export function proximityWeights(offsets: Float64Array, out: Float64Array): number {
  const count = out.length;
  let mean = 0,
    total = 0;
  for (let m = 0; m < count; m++) {
    const x = offsets[3 * m],
      y = offsets[3 * m + 1],
      z = offsets[3 * m + 2];
    mean += out[m] = x * x + y * y + z * z;
  }
  mean = mean / count + 1e-30;
  for (let m = 0; m < count; m++) total += out[m] = 1 / (out[m] / mean + MIN_DISTANCE);
  for (let m = 0; m < count; m++) out[m] /= total;
  return Math.sqrt(mean);
}

/** Quadratic fit to a fixed number of neighbours. */
export class Quadratic {
  /** Terms of all neighbours, one row per term, and the same times the distance weights. Padded with 0. */
  readonly #terms: Float64Array;
  readonly #weightedTerms: Float64Array;
  readonly #row: number;
  readonly #products = new Float64Array(PRODUCTS.length);
  readonly #lower = new Float64Array(TERMS * TERMS);
  readonly #solution = new Float64Array(TERMS);

  constructor(readonly count: number) {
    this.#row = LANES * Math.ceil(count / LANES);
    this.#terms = new Float64Array(TERMS * this.#row);
    this.#weightedTerms = new Float64Array(TERMS * this.#row);
  }

  /**
   * Computes the weights of the best quadratic fit at the origin, given weights that decrease with distance. `unit`
   * scales the offsets.
   */
  weights(offsets: Float64Array, distanceWeights: Float64Array, unit: number, out: Float64Array): void {
    this.#fillTerms(offsets, distanceWeights, 1 / unit);
    this.#multiply();
    for (let a = 0; a < TERMS; a++) {
      for (let b = 0; b <= a; b++) this.#lower[TERMS * a + b] = this.#products[PRODUCT_AT[TERMS * a + b]];
      this.#lower[(TERMS + 1) * a] += RIDGES[a];
    }
    solveForFirst(this.#lower, this.#solution);
    this.#computeWeights(distanceWeights, out);
  }

  #fillTerms(offsets: Float64Array, distanceWeights: Float64Array, scale: number): void {
    const terms = this.#terms,
      row = this.#row;
    for (let m = 0; m < this.count; m++) {
      const x = offsets[3 * m] * scale,
        y = offsets[3 * m + 1] * scale,
        z = offsets[3 * m + 2] * scale;
      terms[m] = 1;
      terms[row + m] = x;
      terms[2 * row + m] = y;
      terms[3 * row + m] = z;
      terms[4 * row + m] = x * x;
      terms[5 * row + m] = y * y;
      terms[6 * row + m] = z * z;
      terms[7 * row + m] = x * y;
      terms[8 * row + m] = x * z;
      terms[9 * row + m] = y * z;
    }
    for (let a = 0, at = 0; a < TERMS; a++, at = a * row)
      for (let m = 0; m < this.count; m++) this.#weightedTerms[at + m] = distanceWeights[m] * terms[at + m];
  }

  #multiply(): void {
    const weightedTerms = this.#weightedTerms,
      terms = this.#terms,
      row = this.#row;
    for (let t = 0; t < FIRSTS.length; t++) {
      let at = FIRSTS[t] * row,
        to = SECONDS[t] * row,
        a = 0,
        b = 0,
        c = 0,
        d = 0;
      for (const end = at + row; at < end; at += LANES, to += LANES) {
        a += weightedTerms[at] * terms[to];
        b += weightedTerms[at + 1] * terms[to + 1];
        c += weightedTerms[at + 2] * terms[to + 2];
        d += weightedTerms[at + 3] * terms[to + 3];
      }
      this.#products[t] = a + b + c + d;
    }
  }

  /** Expresses the value of the fit at the origin as weights of the neighbours. */
  #computeWeights(distanceWeights: Float64Array, out: Float64Array): void {
    const [h0, h1, h2, h3, h4, h5, h6, h7, h8, h9] = this.#solution,
      terms = this.#weightedTerms,
      row = this.#row;
    let total = 0,
      sum = 0;
    for (let m = 0; m < this.count; m++) {
      const straight = h0 * terms[m] + h1 * terms[row + m] + h2 * terms[2 * row + m] + h3 * terms[3 * row + m],
        square = h4 * terms[4 * row + m] + h5 * terms[5 * row + m] + h6 * terms[6 * row + m],
        mixed = h7 * terms[7 * row + m] + h8 * terms[8 * row + m] + h9 * terms[9 * row + m];
      total += out[m] = straight + square + mixed;
    }
    for (let m = 0; m < this.count; m++) sum += Math.abs((out[m] /= total));
    if (sum > MAX_WEIGHT_SUM) out.set(distanceWeights);
  }
}

/** Returns the first column of the inverse of a symmetric positive matrix, given its lower half (Cholesky). */
function solveForFirst(lower: Float64Array, x: Float64Array): void {
  for (let a = 0, row = 0; a < TERMS; a++, row += TERMS) {
    for (let b = 0, other = 0; b < a; b++, other += TERMS) {
      let sum = lower[row + b];
      for (let k = 0; k < b; k++) sum -= lower[row + k] * lower[other + k];
      lower[row + b] = sum * lower[other + b];
    }
    let sum = lower[row + a];
    for (let k = 0; k < a; k++) sum -= lower[row + k] ** 2;
    lower[row + a] = 1 / Math.sqrt(sum); // stores the reciprocal, because multiplication is faster than division
  }
  for (let a = 0; a < TERMS; a++) {
    let sum = a ? 0 : 1;
    for (let k = 0; k < a; k++) sum -= lower[TERMS * a + k] * x[k];
    x[a] = sum * lower[(TERMS + 1) * a];
  }
  for (let a = TERMS - 1; a >= 0; a--) {
    let sum = x[a];
    for (let k = a + 1; k < TERMS; k++) sum -= lower[TERMS * k + a] * x[k];
    x[a] = sum * lower[(TERMS + 1) * a];
  }
}
