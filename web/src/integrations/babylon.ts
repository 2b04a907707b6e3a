// `splatwire/babylon`: Gaussians for `GaussianSplattingMesh` of Babylon.js. Needs nothing of Babylon.js but its mesh.

import type { Gaussians } from "../decoder.ts";

/** Part of Babylon's `GaussianSplattingMesh` that `fillMesh` uses. */
export interface SplattingMesh {
  material: object | null;
  updateData(
    data: ArrayBuffer,
    sh?: Uint8Array[],
    options?: { flipY?: boolean },
    partIndices?: Uint8Array,
    shDegree?: number,
  ): void;
  getScene(): { getEngine(): { getCaps(): { maxTextureSize: number } } };
}

/** Bytes of a Gaussian in Babylon's data: centre and scales in float32, then RGBA and the quaternion in 8 bits. */
const ROW = 32;
/** Harmonics per Gaussian in each of Babylon's textures. */
const PER_TEXTURE = 16;

/**
 * Shows Gaussians in a mesh, instead of those that it had. Keeps the axes of the stream, where y usually points down:
 * `mesh.scaling.y = -1` turns it up in Babylon's left-handed scenes. Babylon.js stores colours, opacities and rotations
 * in 8 bits, and harmonics in steps of 1/127 from -1 to 1.
 */
export function fillMesh(mesh: SplattingMesh, gaussians: Gaussians): void {
  const { count, degree, centres, scales, rotations, opacities, colours, antialiased } = gaussians,
    data = new ArrayBuffer(ROW * count),
    floats = new Float32Array(data),
    bytes = new Uint8ClampedArray(data);
  for (let i = 0; i < count; i++) {
    floats.set(centres.subarray(3 * i, 3 * i + 3), 8 * i);
    floats.set(scales.subarray(3 * i, 3 * i + 3), 8 * i + 3);
    for (let c = 0; c < 3; c++) bytes[ROW * i + 24 + c] = 255 * colours[3 * i + c];
    bytes[ROW * i + 27] = 255 * opacities[i];
    for (let c = 0; c < 4; c++) bytes[ROW * i + 28 + c] = 127.5 + 127.5 * rotations[4 * i + c];
  }
  const harmonics = degree > 0 ? harmonicsOf(gaussians, mesh.getScene().getEngine().getCaps().maxTextureSize) : [];
  mesh.updateData(data, degree > 0 ? harmonics : undefined, { flipY: false }, undefined, degree);
  if (mesh.material && "compensation" in mesh.material) mesh.material.compensation = antialiased;
}

/** Returns the harmonics in rows of Babylon's textures, which have its maximum width. */
function harmonicsOf({ count, degree, harmonics }: Gaussians, width: number): Uint8Array[] {
  const perGaussian = 3 * ((degree + 1) ** 2 - 1),
    size = PER_TEXTURE * width * Math.ceil(count / width),
    textures = Array.from({ length: Math.ceil(perGaussian / PER_TEXTURE) }, () => new Uint8ClampedArray(size));
  for (let i = 0; i < count; i++)
    for (let n = 0; n < perGaussian; n++) {
      const texture = textures[Math.floor(n / PER_TEXTURE)];
      texture[PER_TEXTURE * i + (n % PER_TEXTURE)] = 127.5 + 127.5 * harmonics[perGaussian * i + n];
    }
  return textures.map(({ buffer }) => new Uint8Array(buffer));
}
