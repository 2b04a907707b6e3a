// Gaussians on the graphics card, in textures that PlayCanvas reads.

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

import { upload } from "./card.ts";
import { half, numShTextures, type Packed } from "./packed.ts";
import { readCode } from "./shaders.ts";

/**
 * Centres farther away than so many sizes of the scene are sorted as if they lay there: depths are sorted in buckets.
 */
const FARTHEST = 16;
/** Bytes of a Gaussian's size and opacity, with what shares their texels. */
const GAIN_BYTES = 24;

interface Loose {
  defines: Map<string, unknown>;
}

/** How Gaussians of a degree lie in textures. */
export function formatOf(device: GraphicsDevice, degree: number): GSplatFormat {
  const streams = [
    { name: "dataCenter", format: PIXELFORMAT_RGBA32F },
    { name: "dataColor", format: PIXELFORMAT_RGBA16F },
    { name: "dataScale", format: PIXELFORMAT_RGBA16F },
    { name: "dataRotation", format: PIXELFORMAT_RGBA16F },
    ...Array.from({ length: numShTextures(degree) }, (_, t) => ({ name: `dataSh${t}`, format: PIXELFORMAT_RGBA32U })),
  ];
  return new GSplatFormat(device, streams, { readGLSL: readCode(degree), readWGSL: "" });
}

/** Room for Gaussians of one degree, in units of the scene's size around its middle. */
export class Gaussians extends GSplatContainer {
  count = 0;
  /** Bytes on the card. */
  bytes = 0;
  readonly #opacities: Float32Array;
  /** Texels that gains change, as they are on the card. */
  readonly #places: Float32Array;
  readonly #colours: Uint16Array;

  constructor(
    device: GraphicsDevice,
    readonly capacity: number,
    readonly degree: number,
    format = formatOf(device, degree),
  ) {
    super(device, capacity, format);
    this.#opacities = new Float32Array(capacity);
    this.#places = new Float32Array(4 * capacity);
    this.#colours = new Uint16Array(4 * capacity);
    (this.gsplatData as unknown as { shBands: number }).shBands = degree;
    this.aabb = new BoundingBox(new Vec3(0, 0, 0), new Vec3(FARTHEST, FARTHEST, FARTHEST));
    this.centers!.fill(FARTHEST);
  }

  clear(): void {
    this.count = 0;
  }

  /** Puts Gaussians behind those that are there. */
  add({ count, centers, colours, scales, turns, harmonics, opacities }: Packed): void {
    const textures = { dataCenter: centers, dataColor: colours, dataScale: scales, dataRotation: turns };
    const all = [...Object.entries(textures), ...harmonics.map((texels, t) => [`dataSh${t}`, texels] as const)];
    for (const [name, texels] of all) {
      upload(this.getTexture(name)!, this.count, texels);
      this.bytes += texels.byteLength;
    }
    this.#places.set(centers, 4 * this.count);
    this.#colours.set(colours, 4 * this.count);
    this.#opacities.set(opacities, this.count);
    for (let i = 0, n = 3 * this.count; i < centers.length; i += 4, n += 3) {
      for (let a = 0; a < 3; a++) this.centers![n + a] = Math.min(Math.max(centers[i + a], -FARTHEST), FARTHEST);
    }
    this.count += count;
    this.update(this.count);
  }

  /**
   * Gains of size and opacity of each Gaussian in turn; size 0 hides one. Those behind are shown as they are. Uploads
   * from the first one that changes to the last one; so many bytes.
   */
  setGains(gains: Float32Array): number {
    const places = this.#places,
      colours = this.#colours,
      count = Math.min(gains.length / 2, this.count);
    let first = count,
      end = count;
    for (let n = 0; n < count; n++) {
      const opacity = half(Math.min(this.#opacities[n] * gains[2 * n + 1], 1));
      if (places[4 * n + 3] === gains[2 * n] && colours[4 * n + 3] === opacity) continue;
      places[4 * n + 3] = gains[2 * n];
      colours[4 * n + 3] = opacity;
      if (first === count) first = n;
      end = n + 1;
    }
    if (first === count) return 0;
    upload(this.getTexture("dataCenter")!, first, places.subarray(4 * first, 4 * end));
    upload(this.getTexture("dataColor")!, first, colours.subarray(4 * first, 4 * end));
    return GAIN_BYTES * (end - first);
  }

  override configureMaterialDefines(defines: Loose["defines"]): void {
    defines.set("SH_BANDS", this.degree);
  }
}
