// Explicit Gaussians in floating point.

export const DC = 0.28209479177387814;

export interface Splats {
  readonly count: number;
  /** Degree of the spherical harmonics. */
  readonly degree: number;
  /** Centres x, y, z, shape (count, 3). */
  readonly means: Float32Array;
  /** Unit quaternions w, x, y, z, shape (count, 4). */
  readonly quats: Float32Array;
  /** Standard deviations along the axes, shape (count, 3). */
  readonly scales: Float32Array;
  readonly opacities: Float32Array;
  /** RGB without the view-dependent part, shape (count, 3): 0.5 + DC times the coefficient of degree 0. */
  readonly colours: Float32Array;
  /** Coefficients of degree 1 and above, shape (count, (degree + 1)^2 - 1, 3). */
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

/** Returns Gaussians whose arrays lie one after another in `values`, all zeros by default. */
export function splatsIn(
  count: number,
  degree: number,
  values = new Float32Array((11 + 3 * (degree + 1) ** 2) * count),
): Splats {
  let at = 0;
  const next = (width: number): Float32Array => values.subarray(at, (at += width * count));
  return {
    count,
    degree,
    means: next(3),
    quats: next(4),
    scales: next(3),
    opacities: next(1),
    colours: next(3),
    harmonics: next(3 * ((degree + 1) ** 2 - 1)),
  };
}

/** Returns the memory of a Gaussian in bytes, once decoded and once packed for drawing. */
export function splatBytes(degree: number): number {
  return 2 * 4 * (11 + 3 * (degree + 1) ** 2);
}

/** Returns a selection in the order of `which`. */
export function selectSplats(splats: Splats, which: Int32Array): Splats {
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

/** Returns `count` Gaussians from index `first` on. The arrays share memory with `splats`. */
export function subSplats(splats: Splats, first: number, count: number): Splats {
  const { degree } = splats,
    some = (values: Float32Array, width: number): Float32Array =>
      values.subarray(width * first, width * (first + count));
  return {
    count,
    degree,
    means: some(splats.means, 3),
    quats: some(splats.quats, 4),
    scales: some(splats.scales, 3),
    opacities: some(splats.opacities, 1),
    colours: some(splats.colours, 3),
    harmonics: some(splats.harmonics, 3 * ((degree + 1) ** 2 - 1)),
  };
}
