// Gaussians in GPU textures for PlayCanvas.

import {
  BoundingBox,
  type GraphicsDevice,
  GSplatContainer,
  GSplatFormat,
  PIXELFORMAT_RGBA16F,
  PIXELFORMAT_RGBA32F,
  PIXELFORMAT_RGBA32U,
  Vec3,
} from "playcanvas";

import { uploadTexels } from "./gpu_limits.ts";
import { numShTextures, type Packed, toHalfFloat } from "./packed.ts";
import { readCode } from "./shaders.ts";

/** Clamp of centres in units of the scene's size, for sorting only. It keeps the depth buckets narrow. */
const MAX_SORTED_CENTRE = 16;
/** Bytes uploaded per Gaussian to change its size and opacity. */
const GAIN_BYTES = 24;

/** Largest number of Gaussians between two hidden ones that are uploaded again with them. */
const MAX_HIDDEN_GAP = 64;

interface MaterialDefines {
  defines: Map<string, unknown>;
}

/** Returns the texture layout of Gaussians of a degree. */
export function textureFormat(device: GraphicsDevice, degree: number): GSplatFormat {
  const streams = [
    { name: "dataCenter", format: PIXELFORMAT_RGBA32F },
    { name: "dataColor", format: PIXELFORMAT_RGBA16F },
    { name: "dataScale", format: PIXELFORMAT_RGBA16F },
    { name: "dataRotation", format: PIXELFORMAT_RGBA16F },
    ...Array.from({ length: numShTextures(degree) }, (_, t) => ({ name: `dataSh${t}`, format: PIXELFORMAT_RGBA32U })),
  ];
  return new GSplatFormat(device, streams, { readGLSL: readCode(degree), readWGSL: "" });
}

/** Textures for Gaussians of one degree, in units of the scene's size. */
export class GpuGaussians extends GSplatContainer {
  count = 0;
  /** Number of uploaded bytes. */
  bytes = 0;
  readonly #opacities: Float32Array;
  /** Copies of the texels on the GPU that gains change. */
  readonly #centers: Float32Array;
  readonly #colours: Uint16Array;

  constructor(
    device: GraphicsDevice,
    readonly capacity: number,
    readonly degree: number,
    format = textureFormat(device, degree),
  ) {
    super(device, capacity, format);
    this.#opacities = new Float32Array(capacity);
    this.#centers = new Float32Array(4 * capacity);
    this.#colours = new Uint16Array(4 * capacity);
    (this.gsplatData as unknown as { shBands: number }).shBands = degree;
    this.aabb = new BoundingBox(new Vec3(0, 0, 0), new Vec3(MAX_SORTED_CENTRE, MAX_SORTED_CENTRE, MAX_SORTED_CENTRE));
    this.centers!.fill(MAX_SORTED_CENTRE);
  }

  clear(): void {
    this.count = 0;
  }

  /** Uploads Gaussians behind the earlier ones. They are drawn after `show`. */
  append({ count, centers, colours, scales, rotations, harmonics, opacities }: Packed): void {
    const textures = { dataCenter: centers, dataColor: colours, dataScale: scales, dataRotation: rotations };
    const all = [...Object.entries(textures), ...harmonics.map((texels, t) => [`dataSh${t}`, texels] as const)];
    for (const [name, texels] of all) {
      uploadTexels(this.getTexture(name)!, this.count, texels);
      this.bytes += texels.byteLength;
    }
    this.#centers.set(centers, 4 * this.count);
    this.#colours.set(colours, 4 * this.count);
    this.#opacities.set(opacities, this.count);
    for (let i = 0, n = 3 * this.count; i < centers.length; i += 4, n += 3) {
      for (let a = 0; a < 3; a++)
        this.centers![n + a] = Math.min(Math.max(centers[i + a], -MAX_SORTED_CENTRE), MAX_SORTED_CENTRE);
    }
    this.count += count;
  }

  /** Hides Gaussians for good, by ascending index. Uploads ranges of texels around them. */
  hide(which: Int32Array): void {
    for (let i = 0, first = 0; i < which.length; i++) {
      this.#opacities[which[i]] = this.#centers[4 * which[i] + 3] = this.#colours[4 * which[i] + 3] = 0;
      if (i + 1 < which.length && which[i + 1] - which[i] < MAX_HIDDEN_GAP) continue;
      this.#uploadGains(which[first], which[i] + 1);
      first = i + 1;
    }
  }

  #uploadGains(first: number, end: number): void {
    uploadTexels(this.getTexture("dataCenter")!, first, this.#centers.subarray(4 * first, 4 * end));
    uploadTexels(this.getTexture("dataColor")!, first, this.#colours.subarray(4 * first, 4 * end));
    this.bytes += GAIN_BYTES * (end - first);
  }

  /** Draws everything uploaded. It is sorted first. */
  show(): void {
    this.update(this.count);
  }

  /**
   * Applies gains of size and opacity, shape (count, 2), to the first Gaussians. A size of 0 hides a Gaussian. Uploads
   * the range of changed texels and returns its size in bytes.
   */
  setGains(gains: Float32Array): number {
    const centers = this.#centers,
      colours = this.#colours,
      count = Math.min(gains.length / 2, this.count);
    let first = count,
      end = count;
    for (let n = 0; n < count; n++) {
      const opacity = toHalfFloat(Math.min(this.#opacities[n] * gains[2 * n + 1], 1));
      if (centers[4 * n + 3] === gains[2 * n] && colours[4 * n + 3] === opacity) continue;
      centers[4 * n + 3] = gains[2 * n];
      colours[4 * n + 3] = opacity;
      if (first === count) first = n;
      end = n + 1;
    }
    if (first === count) return 0;
    this.#uploadGains(first, end);
    return GAIN_BYTES * (end - first);
  }

  override configureMaterialDefines(defines: MaterialDefines["defines"]): void {
    defines.set("SH_BANDS", this.degree);
  }
}
