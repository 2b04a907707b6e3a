// Gaussians as the graphics card takes them: made where nobody waits for a frame. Nothing here needs a browser.

import { floatOf } from "../bytes.ts";
import type { Splats } from "../codec/splats.ts";

/** Texels of four numbers for each Gaussian, lengths in units of the scene's size; numbers of 16 bits are halves. */
export interface Packed {
  readonly count: number;
  readonly degree: number;
  /** x, y, z and 1, the gain of its size. */
  readonly centers: Float32Array;
  /** Red, green, blue, opacity. */
  readonly colours: Uint16Array;
  readonly scales: Uint16Array;
  /** Quaternions w, x, y, z with w not below 0. */
  readonly turns: Uint16Array;
  /** Texture after texture; a texel is eight halves of a Gaussian's harmonics. */
  readonly harmonics: readonly Uint32Array[];
  readonly opacities: Float32Array;
}

/** What is drawn of a tile of a scene with levels. */
export interface Tile {
  readonly tile: number;
  readonly packed: Packed;
}

export const numShTextures = (degree: number): number => Math.ceil((3 * ((degree + 1) ** 2 - 1)) / 8);

/** Splats of one degree, one after another. */
export function pack(parts: readonly Splats[], degree: number, size: number): Packed {
  const count = parts.reduce((sum, part) => sum + part.count, 0),
    texels = 4 * count,
    number = 3 * ((degree + 1) ** 2 - 1);
  const all: Packed = {
    count,
    degree,
    centers: new Float32Array(texels).fill(1),
    colours: new Uint16Array(texels),
    scales: new Uint16Array(texels),
    turns: new Uint16Array(texels),
    harmonics: Array.from({ length: numShTextures(degree) }, () => new Uint32Array(texels)),
    opacities: new Float32Array(count),
  };
  let n = 0;
  for (const splats of parts) {
    for (let i = 0; i < splats.count; i++, n++) {
      for (let a = 0; a < 3; a++) {
        all.centers[4 * n + a] = splats.means[3 * i + a] / size;
        all.scales[4 * n + a] = half(splats.scales[3 * i + a] / size);
        all.colours[4 * n + a] = half(splats.colours[3 * i + a]);
      }
      all.colours[4 * n + 3] = half(splats.opacities[i]);
      all.opacities[n] = splats.opacities[i];
      const sign = splats.quats[4 * i] < 0 ? -1 : 1;
      for (let a = 0; a < 4; a++) all.turns[4 * n + a] = half(sign * splats.quats[4 * i + a]);
      for (let j = 0; j < number; j += 2) {
        const first = splats.harmonics[i * number + j],
          second = j + 1 < number ? splats.harmonics[i * number + j + 1] : 0;
        if (first === 0 && second === 0) continue; // as most are
        const low = half(first),
          high = half(second);
        all.harmonics[j >> 3][4 * n + ((j >> 1) & 3)] = (low | (high << 16)) >>> 0;
      }
    }
  }
  return all;
}

/** The buffers, to be handed from a worker. */
export function buffersOf({ centers, colours, scales, turns, harmonics, opacities }: Packed): ArrayBuffer[] {
  return [centers, colours, scales, turns, ...harmonics, opacities].map((array) => array.buffer as ArrayBuffer);
}

const FLOAT = new Float32Array(1),
  BITS = new Uint32Array(FLOAT.buffer);
/** Half of the smallest step between halves below 2^-14, times 2^23: adding it lets floats round as such halves do. */
const SMALL = 2 ** -1;

/** The nearest half of a number; too large ones are infinite. */
export function half(value: number): number {
  FLOAT[0] = value;
  const bits = BITS[0],
    sign = (bits >>> 16) & 0x8000,
    rest = bits & 0x7fffffff;
  if (rest >= 0x47800000) return sign | (rest > 0x7f800000 ? 0x7e00 : 0x7c00);
  if (rest < 0x38800000) {
    BITS[0] = rest;
    FLOAT[0] += SMALL;
    return sign | (BITS[0] - 0x3f000000);
  }
  return sign | ((rest - 0x38000000 + 0xfff + ((rest >>> 13) & 1)) >>> 13);
}

/** The float of each half. */
export const FLOATS: Float32Array = Float32Array.from({ length: 65536 }, (_, bits) => floatOf(bits));
