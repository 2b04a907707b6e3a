// Gaussians in the layout of GPU textures. Runs in workers, and needs no browser.

import { floatOf } from "../bytes.ts";
import type { Splats } from "../codec/splats.ts";

/**
 * Texels of four numbers per Gaussian. Lengths are in units of the scene's size. 16-bit numbers are half floats. The
 * arrays may be views of one buffer.
 */
export interface Packed {
  readonly count: number;
  readonly degree: number;
  /** x, y, z and the size gain, initially 1. */
  readonly centers: Float32Array;
  /** Red, green, blue, opacity. */
  readonly colours: Uint16Array;
  readonly scales: Uint16Array;
  /** Quaternions w, x, y, z with w >= 0. */
  readonly rotations: Uint16Array;
  /** One array per texture. A texel has eight half floats of a Gaussian's harmonics. */
  readonly harmonics: readonly Uint32Array[];
  /** Opacities before gains. Used on the CPU only, in no texture. */
  readonly opacities: Float32Array;
}

/** Drawn Gaussians of a tile. */
export interface Tile {
  readonly tile: number;
  readonly packed: Packed;
}

export const numShTextures = (degree: number): number => Math.ceil((3 * ((degree + 1) ** 2 - 1)) / 8);

/** Gaussians that were packed elsewhere, until they are packed together with others. */
const packedBefore = new WeakMap<Splats, Packed>();

/** Gives `pack` the result for some Gaussians, for one call. */
export function keepPacked(splats: Splats, packed: Packed): void {
  packedBefore.set(splats, packed);
}

/** Packs Gaussians of one degree, part after part, into one buffer. `size` is the unit of length. */
export function pack(parts: readonly Splats[], degree: number, size: number): Packed {
  const count = parts.reduce((sum, part) => sum + part.count, 0),
    texels = 4 * count,
    number = 3 * ((degree + 1) ** 2 - 1),
    textures = numShTextures(degree),
    buffer = new ArrayBuffer((44 + 16 * textures) * count);
  const halves = (n: number): Uint16Array => new Uint16Array(buffer, (20 + 16 * textures + 8 * n) * count, texels),
    all: Packed = {
      count,
      degree,
      centers: new Float32Array(buffer, 0, texels).fill(1),
      colours: halves(0),
      scales: halves(1),
      rotations: halves(2),
      harmonics: Array.from({ length: textures }, (_, t) => new Uint32Array(buffer, (20 + 16 * t) * count, texels)),
      opacities: new Float32Array(buffer, 16 * count, count),
    };
  const { centers, scales, rotations, opacities: opaque } = all;
  let n = 0;
  for (const splats of parts) {
    const before = packedBefore.get(splats);
    if (before) {
      const from = arraysOf(before);
      for (const [a, array] of arraysOf(all).entries()) array.set(from[a], (array.length / count) * n);
      packedBefore.delete(splats);
      n += splats.count;
      continue;
    }
    const { means, scales: sizes } = splats,
      [colours, opacities, quats, harmonics] = [splats.colours, splats.opacities, splats.quats, splats.harmonics].map(
        ({ buffer, byteOffset, length }) => new Uint32Array(buffer, byteOffset, length),
      );
    for (let i = 0; i < splats.count; i++, n++) {
      const sign = splats.quats[4 * i] < 0 ? 1 << 31 : 0;
      for (let a = 0; a < 3; a++) {
        centers[4 * n + a] = means[3 * i + a] / size;
        scales[4 * n + a] = toHalfFloat(sizes[3 * i + a] / size);
        all.colours[4 * n + a] = halfOf(colours[3 * i + a]);
      }
      all.colours[4 * n + 3] = halfOf(opacities[i]);
      opaque[n] = splats.opacities[i];
      for (let a = 0; a < 4; a++) rotations[4 * n + a] = halfOf(sign ^ quats[4 * i + a]);
      for (let j = 0; j < number; j += 2) {
        const first = harmonics[i * number + j],
          second = j + 1 < number ? harmonics[i * number + j + 1] : 0;
        if (first === 0 && second === 0) continue; // the most frequent case
        all.harmonics[j >> 3][4 * n + ((j >> 1) & 3)] = (halfOf(first) | (halfOf(second) << 16)) >>> 0;
      }
    }
  }
  return all;
}

/** Hides a Gaussian for good: its size and opacity become 0. */
export function hide({ centers, colours, opacities }: Packed, n: number): void {
  centers[4 * n + 3] = colours[4 * n + 3] = opacities[n] = 0;
}

/** Returns the arrays in a fixed order. */
const arraysOf = ({ centers, colours, scales, rotations, harmonics, opacities }: Packed) => [
  centers,
  colours,
  scales,
  rotations,
  ...harmonics,
  opacities,
];

/** Returns the buffer of what `pack` returned, for transfer from a worker. */
export const bufferOf = ({ centers }: Packed): ArrayBuffer => centers.buffer as ArrayBuffer;

const FLOAT = new Float32Array(1),
  BITS = new Uint32Array(FLOAT.buffer);
/** Half of the smallest step between half floats below 2^-14, times 2^23. Adding it rounds a float to such a half. */
const SUBNORMAL_BIAS = 2 ** -1;

/** Returns the bits of the nearest half float. Numbers that are too large become infinite. */
export function toHalfFloat(value: number): number {
  FLOAT[0] = value;
  return halfOf(BITS[0]);
}

/** Returns the bits of the half float nearest to the float with these bits. */
function halfOf(bits: number): number {
  const sign = (bits >>> 16) & 0x8000,
    rest = bits & 0x7fffffff;
  if (rest >= 0x47800000) return sign | (rest > 0x7f800000 ? 0x7e00 : 0x7c00);
  if (rest < 0x38800000) {
    BITS[0] = rest;
    FLOAT[0] += SUBNORMAL_BIAS;
    return sign | (BITS[0] - 0x3f000000);
  }
  return sign | ((rest - 0x38000000 + 0xfff + ((rest >>> 13) & 1)) >>> 13);
}

/** Number value of each half float, indexed by its bits. */
export const HALF_FLOAT_VALUES: Float32Array = /* @__PURE__ */ Float32Array.from({ length: 65536 }, (_, bits) =>
  floatOf(bits),
);
