// Affine layers of neural networks.

/** Rows and outputs per block. The sums of a block fit into registers. */
export const ROWS = 4;
const COLUMNS = 2;

/** Affine layer: weights, shape (outputs, inputs), and biases, shape (outputs). */
export interface Affine {
  readonly inputs: number;
  readonly outputs: number;
  readonly weights: Float64Array;
  readonly bias: Float64Array;
}

/** Returns the layer with an even number of outputs. An added output is 0. */
export function padded({ inputs, outputs, weights, bias }: Affine): Affine {
  const even = Math.ceil(outputs / COLUMNS) * COLUMNS,
    all = new Float64Array(even * inputs),
    biases = new Float64Array(even);
  all.set(weights);
  biases.set(bias);
  return { inputs, outputs: even, weights: all, bias: biases };
}

/**
 * Evaluates a layer with an even number of outputs. Input rows begin `stride` apart; `rows` is a multiple of `ROWS`.
 * Results go to `out`, shape (rows, outputs).
 */
export function affine(
  { inputs, outputs, weights, bias }: Affine,
  x: Float64Array,
  stride: number,
  rows: number,
  out: Float64Array,
): void {
  for (let n = 0; n < rows; n += ROWS) {
    const a = n * stride,
      b = a + stride,
      c = b + stride,
      d = c + stride;
    for (let o = 0; o < outputs; o += COLUMNS) {
      let a0 = bias[o],
        b0 = a0,
        c0 = a0,
        d0 = a0,
        a1 = bias[o + 1],
        b1 = a1,
        c1 = a1,
        d1 = a1;
      const first = o * inputs,
        second = first + inputs;
      for (let i = 0; i < inputs; i++) {
        const u = weights[first + i],
          v = weights[second + i],
          xa = x[a + i],
          xb = x[b + i],
          xc = x[c + i],
          xd = x[d + i];
        a0 += u * xa;
        b0 += u * xb;
        c0 += u * xc;
        d0 += u * xd;
        a1 += v * xa;
        b1 += v * xb;
        c1 += v * xc;
        d1 += v * xd;
      }
      const at = n * outputs + o;
      out[at] = a0;
      out[at + 1] = a1;
      out[at + outputs] = b0;
      out[at + outputs + 1] = b1;
      out[at + 2 * outputs] = c0;
      out[at + 2 * outputs + 1] = c1;
      out[at + 3 * outputs] = d0;
      out[at + 3 * outputs + 1] = d1;
    }
  }
}
