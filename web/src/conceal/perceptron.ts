// Network with standardised inputs, one hidden layer and two outputs. Counterpart of
// `splatwire.concealment.scene_free.network.Perceptron`.

import { fromBase64 } from "../bytes.ts";

const MAX_STANDARDISED = 3;

/** Network weights as stored in `scene_free_weights.ts`. */
interface Weights {
  readonly inputs: number;
  readonly hidden: number;
  readonly bytes: string;
}

/** Returns a function that evaluates the network. Standardised inputs are clamped to [-3, 3]. */
export function perceptron({ inputs, hidden, bytes }: Weights): (signature: Float64Array) => [number, number] {
  const numbers = new Float32Array(fromBase64(bytes).buffer);
  let at = 0;
  const next = (count: number): Float32Array => numbers.subarray(at, (at += count));
  const mean = next(inputs),
    spread = next(inputs),
    first = next(hidden * inputs),
    firstBias = next(hidden),
    last = next(2 * hidden),
    lastBias = next(2);
  const standardised = new Float64Array(inputs);
  return (signature) => {
    const found: [number, number] = [lastBias[0], lastBias[1]];
    for (let n = 0; n < inputs; n++)
      standardised[n] = Math.min(Math.max((signature[n] - mean[n]) / spread[n], -MAX_STANDARDISED), MAX_STANDARDISED);
    for (let h = 0; h < hidden; h++) {
      let sum = firstBias[h];
      for (let n = 0; n < inputs; n++) sum += first[h * inputs + n] * standardised[n];
      const active = sum / (1 + Math.exp(-sum));
      found[0] += last[h] * active;
      found[1] += last[hidden + h] * active;
    }
    return found;
  };
}
