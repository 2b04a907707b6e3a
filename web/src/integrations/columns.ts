// Gaussians as columns of a 3DGS PLY file: log sizes, logits of opacities, harmonics channel by channel.

import { DC } from "../codec/splats.ts";
import type { Gaussians } from "../decoder.ts";

export type Columns = readonly (readonly [string, Float32Array])[];

/** Returns all columns with their names, in the order of such files. */
export function plyColumns({ count, degree, centres, rotations, scales, ...rest }: Gaussians): Columns {
  const number = (degree + 1) ** 2 - 1,
    names = (start: string, count: number): string[] => Array.from({ length: count }, (_, n) => start + n);
  const column = (value: (i: number) => number): Float32Array =>
    Float32Array.from({ length: count }, (_, i) => value(i));
  return [
    ...["x", "y", "z"].map((name, a) => [name, column((i) => centres[3 * i + a])] as const),
    ...names("f_dc_", 3).map((name, a) => [name, column((i) => (rest.colours[3 * i + a] - 0.5) / DC)] as const),
    ...names("f_rest_", 3 * number).map((name, n) => {
      const channel = Math.floor(n / number),
        coefficient = n % number;
      return [name, column((i) => rest.harmonics[3 * (i * number + coefficient) + channel])] as const;
    }),
    ["opacity", column((i) => logit(rest.opacities[i]))],
    ...names("scale_", 3).map((name, a) => [name, column((i) => Math.log(scales[3 * i + a]))] as const),
    ...names("rot_", 4).map((name, a) => [name, column((i) => rotations[4 * i + a])] as const),
  ];
}

/**
 * Logit of an opacity. Opacity 1 maps to the logit of the largest smaller float, because some readers reject
 * infinities.
 */
const logit = (opacity: number): number => {
  const below = Math.min(opacity, 1 - 2 ** -24);
  return Math.log(below / (1 - below));
};
