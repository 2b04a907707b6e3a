// Neural heads, which derive the Gaussians of a view from anchors. Counterpart of
// `splatwire.neural.model.gaussian_heads`.

import { emptySplats, type Splats, splatBytes, subSplats } from "../codec/splats.ts";
import { type Affine, affine, padded, ROWS } from "./affine.ts";
import { type Anchors, inView } from "./anchors.ts";
import { type Camera, cameraPosition } from "./camera.ts";

/** Network output for an opacity of 1/255, the least that is drawn. */
const MIN_LOGIT = Math.atanh(1 / 255),
  MIN_NORM = 1e-12;
/** Inputs after the feature vector: direction from the camera (3) and distance. */
const VIEW_INPUTS = 4;

/** Network of two layers with a leaky rectifier in between. `slope` applies below zero. */
export interface Mlp {
  readonly hidden: Affine;
  readonly output: Affine;
  readonly slope: number;
}

/** Gaussians and the index of each one's anchor. */
export interface Spawned {
  readonly splats: Splats;
  readonly owners: Int32Array;
}

/**
 * Networks for opacity, covariance and colour.
 *
 * The features' contribution to the hidden layers is the same in every view. It is computed once by
 * `featureActivations` and then replaces the features.
 */
export class Heads {
  readonly #networks: readonly Mlp[];
  /** Hidden layers of all three networks, split by input: feature vector; direction and distance. */
  readonly #featureLayer: Affine;
  readonly #viewWeights: Float64Array;
  /** Index of each network's first hidden unit among all, and the total. */
  readonly #offsets: number[];
  /** Number of hidden units of all networks, rounded up to an even number. */
  readonly #width: number;
  readonly #hidden: Float64Array;
  readonly #shape = new Float64Array(7);
  readonly #color = new Float64Array(3);

  constructor(opacity: Mlp, covariance: Mlp, color: Mlp) {
    this.#networks = [opacity, covariance, color];
    const hidden = this.#networks.map((network) => network.hidden),
      inputs = hidden[0].inputs,
      features = inputs - VIEW_INPUTS;
    const rows = hidden.flatMap(({ weights, outputs }) =>
      Array.from({ length: outputs }, (_, o) => weights.subarray(o * inputs, (o + 1) * inputs)),
    );
    const join = (parts: Float64Array[]): Float64Array => Float64Array.from(parts.flatMap((part) => [...part]));
    this.#viewWeights = join(rows.map((row) => row.subarray(features)));
    this.#featureLayer = padded({
      inputs: features,
      outputs: rows.length,
      weights: join(rows.map((row) => row.subarray(0, features))),
      bias: join(hidden.map(({ bias }) => bias)),
    });
    this.#offsets = [0];
    for (const { outputs } of hidden) this.#offsets.push(this.#offsets[this.#offsets.length - 1] + outputs);
    this.#width = this.#featureLayer.outputs;
    this.#hidden = new Float64Array(this.#width);
  }

  /** Returns the memory of an anchor including the Gaussians of a view, bytes. */
  anchorBytes(numOffsets: number): number {
    return 4 * (7 + this.#width) + numOffsets * (13 + splatBytes(0));
  }

  /** Computes the contribution of features, shape (count, inputs), to the hidden layers, shape (count, width). */
  featureActivations(features: Float32Array): Float32Array {
    const inputs = this.#featureLayer.inputs,
      count = features.length / inputs,
      rows = Math.ceil(count / ROWS) * ROWS;
    const all = new Float64Array(rows * inputs),
      out = new Float64Array(rows * this.#width);
    all.set(features);
    affine(this.#featureLayer, all, inputs, rows, out);
    return new Float32Array(out.subarray(0, count * this.#width));
  }

  /**
   * Returns the Gaussians of all anchors in the camera's view with an opacity of at least 1/255, in anchor order.
   * `hidden` is the result of `featureActivations`.
   */
  spawn(anchors: Anchors, hidden: Float32Array, camera: Camera): Spawned {
    const { count, numOffsets, positions, scales, masks } = anchors,
      most = masks.reduce((sum, there) => sum + there, 0);
    const splats = emptySplats(most, 0),
      owners = new Int32Array(most),
      eye = cameraPosition(camera);
    let found = 0;
    for (let n = 0; n < count; n++) {
      const x = positions[3 * n],
        y = positions[3 * n + 1],
        z = positions[3 * n + 2];
      if (!inView(camera, x, y, z, scales[n])) continue;
      const dx = x - eye[0],
        dy = y - eye[1],
        dz = z - eye[2],
        distance = Math.sqrt(dx * dx + dy * dy + dz * dz),
        first = found;
      this.#activate(0, hidden, n, dx / distance, dy / distance, dz / distance, distance);
      for (let k = 0; k < numOffsets; k++) {
        if (!masks[n * numOffsets + k]) continue;
        const logit = this.#output(0, k);
        if (!(logit >= MIN_LOGIT)) continue;
        if (first === found) {
          for (const network of [1, 2])
            this.#activate(network, hidden, n, dx / distance, dy / distance, dz / distance, distance);
        }
        splats.opacities[found] = Math.tanh(logit);
        owners[found] = n;
        this.#write(anchors, n, k, splats, found++);
      }
    }
    return { splats: subSplats(splats, 0, found), owners: owners.subarray(0, found) };
  }

  /** Computes a network's hidden layer for one anchor. */
  #activate(
    network: number,
    prepared: Float32Array,
    anchor: number,
    x: number,
    y: number,
    z: number,
    distance: number,
  ): void {
    const { slope } = this.#networks[network],
      weights = this.#viewWeights,
      active = this.#hidden,
      end = this.#offsets[network + 1];
    for (
      let o = this.#offsets[network], from = anchor * this.#width + o, at = o * VIEW_INPUTS;
      o < end;
      o++, from++, at += VIEW_INPUTS
    ) {
      const sum =
        prepared[from] + weights[at] * x + weights[at + 1] * y + weights[at + 2] * z + weights[at + 3] * distance;
      active[o] = sum > 0 ? sum : sum * slope;
    }
  }

  /**
   * Computes `out.length` outputs (one, three or seven) of a network, beginning with output `n`. Independent sums let
   * the processor overlap them.
   */
  #outputs(network: number, n: number, out: Float64Array): void {
    const { inputs, weights, bias } = this.#networks[network].output,
      first = this.#offsets[network],
      active = this.#hidden;
    let o = 0;
    for (; o + 1 < out.length; o += 2) {
      let a = bias[n + o],
        b = bias[n + o + 1],
        c = 0,
        d = 0,
        i = 0;
      const at = (n + o) * inputs,
        next = at + inputs;
      for (; i + 1 < inputs; i += 2) {
        const u = active[first + i],
          v = active[first + i + 1];
        a += weights[at + i] * u;
        b += weights[next + i] * u;
        c += weights[at + i + 1] * v;
        d += weights[next + i + 1] * v;
      }
      if (i < inputs) {
        a += weights[at + i] * active[first + i];
        b += weights[next + i] * active[first + i];
      }
      out[o] = a + c;
      out[o + 1] = b + d;
    }
    if (o < out.length) out[o] = this.#output(network, n + o);
  }

  #output(network: number, n: number): number {
    const { inputs, weights, bias } = this.#networks[network].output,
      first = this.#offsets[network],
      active = this.#hidden,
      at = n * inputs;
    let a = bias[n],
      b = 0,
      c = 0,
      d = 0,
      i = 0;
    for (; i + 3 < inputs; i += 4) {
      a += weights[at + i] * active[first + i];
      b += weights[at + i + 1] * active[first + i + 1];
      c += weights[at + i + 2] * active[first + i + 2];
      d += weights[at + i + 3] * active[first + i + 3];
    }
    for (; i < inputs; i++) a += weights[at + i] * active[first + i];
    return a + b + (c + d);
  }

  /** Writes mean, quaternion, scale and colour of one Gaussian. */
  #write(
    { numOffsets, positions, scales, sizes, offsets }: Anchors,
    n: number,
    k: number,
    splats: Splats,
    at: number,
  ): void {
    const shape = this.#shape,
      color = this.#color;
    this.#outputs(1, 7 * k, shape);
    this.#outputs(2, 3 * k, color);
    const norm = Math.max(
      Math.sqrt(shape[3] * shape[3] + shape[4] * shape[4] + shape[5] * shape[5] + shape[6] * shape[6]),
      MIN_NORM,
    );
    for (let a = 0; a < 3; a++) {
      splats.means[3 * at + a] = positions[3 * n + a] + offsets[3 * (n * numOffsets + k) + a] * scales[n];
      splats.scales[3 * at + a] = sizes[3 * n + a] * sigmoid(shape[a]);
      splats.colours[3 * at + a] = sigmoid(color[a]);
    }
    for (let a = 0; a < 4; a++) splats.quats[4 * at + a] = shape[3 + a] / norm;
  }
}

function sigmoid(value: number): number {
  return 1 / (1 + Math.exp(-value));
}
