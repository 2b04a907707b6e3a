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

/** The buffers of some splats, to be handed from a worker. */
export function buffersOf(splats: Splats): ArrayBuffer[] {
  return [splats.means, splats.quats, splats.scales, splats.opacities, splats.colours, splats.harmonics].map((a) => a.buffer as ArrayBuffer);
}
