// `splatwire/three-core`: Gaussians for `GaussianSplat`, the mesh of three.js for WebGPURenderer.

import { type BufferGeometry, Matrix4, Quaternion, Vector3 } from "three";
import {
  createGaussianSplatGeometry,
  createPackedSphericalHarmonicsBand,
} from "three/addons/utils/GaussianSplatUtils.js";

import type { Gaussians } from "../decoder.ts";

/** Number of numbers per Gaussian before and in each degree of the harmonics: coefficients times RGB. */
const BANDS = [
  { degree: 1, first: 0, length: 9 },
  { degree: 2, first: 9, length: 15 },
  { degree: 3, first: 24, length: 21 },
] as const;

/**
 * Returns Gaussians for three.js: `new GaussianSplat(geometryOf(gaussians))`. Keeps the axes of the stream, where y
 * usually points down. three.js stores colours and opacities in 8 bits, harmonics in steps of 1/128 from -1 to 1, and
 * draws all Gaussians antialiased.
 */
export function geometryOf(gaussians: Gaussians): BufferGeometry {
  const { count, degree, centres, opacities, colours, harmonics } = gaussians,
    rgba = new Uint8ClampedArray(4 * count),
    perGaussian = 3 * ((degree + 1) ** 2 - 1),
    bands: Record<string, Uint32Array> = {};
  for (let i = 0; i < count; i++) {
    for (let c = 0; c < 3; c++) rgba[4 * i + c] = 255 * colours[3 * i + c];
    rgba[4 * i + 3] = 255 * opacities[i];
  }
  for (const band of BANDS.slice(0, degree)) {
    const { packed, bytes } = createPackedSphericalHarmonicsBand(count, band.degree),
      stride = bytes.length / count;
    for (let i = 0; i < count; i++)
      for (let n = 0; n < band.length; n++)
        bytes[stride * i + n] = 128 + 128 * harmonics[perGaussian * i + band.first + n];
    bands[`sh${band.degree}`] = packed;
  }
  return createGaussianSplatGeometry(centres, covariancesOf(gaussians), rgba, bands);
}

/** Returns covariance matrices: xx, xy, xz, yy, yz, zz, shape (count, 6). */
function covariancesOf({ count, rotations, scales }: Gaussians): Float32Array {
  const found = new Float32Array(6 * count),
    [axes, transposed] = [new Matrix4(), new Matrix4()],
    [rotation, scale] = [new Quaternion(), new Vector3()],
    zero = new Vector3();
  for (let i = 0; i < count; i++) {
    const [w, x, y, z] = rotations.subarray(4 * i, 4 * i + 4);
    axes.compose(zero, rotation.set(x, y, z, w), scale.fromArray(scales, 3 * i));
    const m = axes.multiply(transposed.copy(axes).transpose()).elements;
    found.set([m[0], m[4], m[8], m[5], m[9], m[10]], 6 * i);
  }
  return found;
}
