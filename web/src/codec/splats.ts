// Explicit Gaussians as they are drawn.

export const DC = 0.28209479177387814;

export interface Splats {
  readonly count: number;
  /** Degree of the harmonics. */
  readonly degree: number;
  /** x, y, z of each. */
  readonly means: Float32Array;
  /** Unit quaternions w, x, y, z. */
  readonly quats: Float32Array;
  /** Standard deviations along the axes. */
  readonly scales: Float32Array;
  readonly opacities: Float32Array;
  /** Colour from everywhere, 0.5 + DC sh0. */
  readonly colours: Float32Array;
  /** Harmonics but degree 0: coefficient after coefficient, three channels each. */
  readonly harmonics: Float32Array;
}

export function emptySplats(count: number, degree: number): Splats {
  const number = (degree + 1) ** 2 - 1;
  return {
    count,
    degree,
    means: new Float32Array(3 * count),
    quats: new Float32Array(4 * count),
    scales: new Float32Array(3 * count),
    opacities: new Float32Array(count),
    colours: new Float32Array(3 * count),
    harmonics: new Float32Array(3 * number * count),
  };
}

/** Memory that a Gaussian takes: once as it was decoded, and once as it is drawn. */
export function splatBytes(degree: number): number {
  return 2 * 4 * (11 + 3 * (degree + 1) ** 2);
}

/** Some of them, in this order. */
export function chosen(splats: Splats, which: Int32Array): Splats {
  const some = (values: Float32Array): Float32Array => {
    const width = values.length / Math.max(splats.count, 1),
      found = new Float32Array(width * which.length);
    which.forEach((from, to) => found.set(values.subarray(width * from, width * (from + 1)), width * to));
    return found;
  };
  const { degree, means, quats, scales, opacities, colours, harmonics } = splats;
  return {
    count: which.length,
    degree,
    means: some(means),
    quats: some(quats),
    scales: some(scales),
    opacities: some(opacities),
    colours: some(colours),
    harmonics: some(harmonics),
  };
}

/** The first of some splats; shares their memory. */
export function firstOf(splats: Splats, count: number): Splats {
  const { degree } = splats;
  return {
    count,
    degree,
    means: splats.means.subarray(0, 3 * count),
    quats: splats.quats.subarray(0, 4 * count),
    scales: splats.scales.subarray(0, 3 * count),
    opacities: splats.opacities.subarray(0, count),
    colours: splats.colours.subarray(0, 3 * count),
    harmonics: splats.harmonics.subarray(0, 3 * ((degree + 1) ** 2 - 1) * count),
  };
}
