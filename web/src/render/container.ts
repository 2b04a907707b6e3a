// Gaussians on the graphics card, in textures that PlayCanvas reads.

import {
  BoundingBox, FloatPacking, GSplatContainer, GSplatFormat, PIXELFORMAT_RGBA16F, PIXELFORMAT_RGBA32F, PIXELFORMAT_RGBA32U, Vec3,
  type GraphicsDevice, type Texture,
} from "playcanvas";

import type { Splats } from "../codec/splats.ts";
import { numShTextures, readCode } from "./shaders.ts";

const half = FloatPacking.float2Half;
/** Centres farther away than so many sizes of the scene are sorted as if they lay there: depths are sorted in buckets. */
const FARTHEST = 16;

interface Loose {
  defines: Map<string, unknown>;
}

/** Room for Gaussians of one degree, in units of the scene's size around its middle. */
export class Gaussians extends GSplatContainer {
  count = 0;
  readonly #numSh: number;
  readonly #opacities: Float32Array;

  constructor(device: GraphicsDevice, readonly capacity: number, readonly degree: number) {
    const streams = [
      { name: "dataCenter", format: PIXELFORMAT_RGBA32F },
      { name: "dataColor", format: PIXELFORMAT_RGBA16F },
      { name: "dataScale", format: PIXELFORMAT_RGBA16F },
      { name: "dataRotation", format: PIXELFORMAT_RGBA16F },
      ...Array.from({ length: numShTextures(degree) }, (_, t) => ({ name: `dataSh${t}`, format: PIXELFORMAT_RGBA32U })),
    ];
    super(device, capacity, new GSplatFormat(device, streams, { readGLSL: readCode(degree), readWGSL: "" }));
    this.#numSh = numShTextures(degree);
    this.#opacities = new Float32Array(capacity);
    (this.gsplatData as unknown as { shBands: number }).shBands = degree;
    this.aabb = new BoundingBox(new Vec3(0, 0, 0), new Vec3(FARTHEST, FARTHEST, FARTHEST));
    this.centers!.fill(FARTHEST);
  }

  /** Puts Gaussians behind those that are there. */
  add(splats: Splats, size: number): void {
    const center = this.#lock("dataCenter"), color = this.#lock("dataColor"), scale = this.#lock("dataScale"), turn = this.#lock("dataRotation");
    const sh = Array.from({ length: this.#numSh }, (_, t) => this.#lock(`dataSh${t}`)), number = 3 * ((this.degree + 1) ** 2 - 1);
    for (let i = 0, n = this.count; i < splats.count; i++, n++) {
      for (let a = 0; a < 3; a++) {
        const place = splats.means[3 * i + a] / size;
        center[4 * n + a] = place;
        this.centers![3 * n + a] = Math.min(Math.max(place, -FARTHEST), FARTHEST);
        scale[4 * n + a] = half(splats.scales[3 * i + a] / size);
        color[4 * n + a] = half(splats.colours[3 * i + a]);
      }
      center[4 * n + 3] = 1;
      color[4 * n + 3] = half(splats.opacities[i]);
      this.#opacities[n] = splats.opacities[i];
      const sign = splats.quats[4 * i] < 0 ? -1 : 1;
      for (let a = 0; a < 4; a++) turn[4 * n + a] = half(sign * splats.quats[4 * i + a]);
      for (let j = 0; j + 1 <= number; j += 2) {
        const low = half(splats.harmonics[i * number + j]), high = j + 1 < number ? half(splats.harmonics[i * number + j + 1]) : 0;
        sh[j >> 3][4 * n + ((j >> 1) & 3)] = (low | (high << 16)) >>> 0;
      }
    }
    this.count += splats.count;
    for (const name of ["dataCenter", "dataColor", "dataScale", "dataRotation"]) this.#texture(name).unlock();
    for (let t = 0; t < this.#numSh; t++) this.#texture(`dataSh${t}`).unlock();
    this.update(this.count);
  }

  /** Gains of size and opacity of each Gaussian in turn; size 0 hides one. Those behind are shown as they are. */
  setGains(gains: Float32Array): void {
    const center = this.#lock("dataCenter"), color = this.#lock("dataColor"), count = Math.min(gains.length / 2, this.count);
    for (let n = 0; n < count; n++) {
      center[4 * n + 3] = gains[2 * n];
      color[4 * n + 3] = half(Math.min(this.#opacities[n] * gains[2 * n + 1], 1));
    }
    this.#texture("dataCenter").unlock();
    this.#texture("dataColor").unlock();
  }

  override configureMaterialDefines(defines: Loose["defines"]): void {
    defines.set("SH_BANDS", this.degree);
  }

  #texture(name: string): Texture {
    return this.getTexture(name)!;
  }

  #lock(name: string): Float32Array | Uint16Array | Uint32Array {
    return this.#texture(name).lock() as Float32Array | Uint16Array | Uint32Array;
  }
}
