// Gaussians as the columns of a 3DGS PLY: logarithms of sizes, logits of opacities, harmonics channel after channel.

import { DC } from "../codec/splats.ts";
import type { Gaussians } from "../decoder.ts";

export type Columns = readonly (readonly [string, Float32Array])[];

/** Every column by name, in the order of such files. */
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

/** Of opacity 1 the logit of the largest float below it: files of infinities are refused by some readers. */
const logit = (opacity: number): number => {
  const below = Math.min(opacity, 1 - 2 ** -24);
  return Math.log(below / (1 - below));
};
