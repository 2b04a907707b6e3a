// A clip as a mesh of three.js, drawn by Spark.

import { ExtSplats, SplatMesh, utils } from "@sparkjsdev/spark";

import type { Clip, ClipFrame } from "../clip.ts";
import { HALF_FLOAT_VALUES, type Packed } from "../render/packed.ts";
import { coefficientSlots, TEXTURE_NAMES } from "./spark_harmonics.ts";

/**
 * Mesh that shows a clip: `scene.add(new ClipMesh(clip))`. Call `updateClip` before each picture. Keeps the axes of the
 * stream. The options of the `SparkRenderer` are those of `blurOf(clip)`.
 */
export class ClipMesh extends SplatMesh {
  /** Degree of the harmonics that `splats` has memory for. */
  #degree = -1;

  constructor(readonly clip: Clip) {
    super({ splats: new ExtSplats(), raycastable: false });
  }

  /** Shows the newest frame of the clip. Returns it, or null if nothing changed. */
  updateClip(): ClipFrame | null {
    const frame = this.clip.update();
    if (frame) this.#show(frame.packed);
    return frame;
  }

  #show(packed: Packed): void {
    const before = this.splats as ExtSplats,
      room = utils.getTextureSize(packed.count).maxSplats,
      fits = before.maxSplats >= packed.count && this.#degree === packed.degree,
      splats = fits ? before : emptySplats(room, packed.degree);
    this.#degree = packed.degree;
    fill(splats, packed, this.clip.size);
    splats.numSplats = packed.count;
    this.splats = splats;
    if (splats !== before) before.dispose();
    this.updateVersion();
  }
}

/** Returns memory for `room` Gaussians of a degree. */
function emptySplats(room: number, degree: number): ExtSplats {
  const texels = (): Uint32Array => new Uint32Array(4 * room),
    names = new Set(coefficientSlots(degree).map(([name]) => name));
  return new ExtSplats({
    extArrays: [texels(), texels()],
    numSplats: room,
    extra: Object.fromEntries([...names].map((name) => [name, texels()])),
  });
}

/** Replaces the Gaussians in the memory of `splats`. `size` is the unit of length. */
function fill(splats: ExtSplats, packed: Packed, size: number): void {
  const { count, degree, centers, colours, scales, rotations } = packed,
    { extArrays, extra, textures } = splats,
    value = HALF_FLOAT_VALUES;
  for (let i = 0, n = 0; i < count; i++, n += 4) {
    utils.encodeExtSplat(
      extArrays,
      i,
      centers[n] * size,
      centers[n + 1] * size,
      centers[n + 2] * size,
      value[scales[n]] * size,
      value[scales[n + 1]] * size,
      value[scales[n + 2]] * size,
      value[rotations[n + 1]],
      value[rotations[n + 2]],
      value[rotations[n + 3]],
      value[rotations[n]],
      value[colours[n + 3]],
      value[colours[n]],
      value[colours[n + 1]],
      value[colours[n + 2]],
    );
  }
  for (const texture of textures) texture.needsUpdate = true;
  const harmonic = (i: number, n: number): number =>
    value[(packed.harmonics[n >> 3][4 * i + ((n >> 1) & 3)] >>> (16 * (n & 1))) & 0xffff];
  for (const [j, [name, word]] of coefficientSlots(degree).entries()) {
    const texels = extra[name] as Uint32Array;
    for (let i = 0; i < count; i++)
      texels[4 * i + word] = utils.encodeExtRgb(harmonic(i, 3 * j), harmonic(i, 3 * j + 1), harmonic(i, 3 * j + 2));
    const uploaded = extra[TEXTURE_NAMES[name]] as { value: { needsUpdate: boolean } } | undefined;
    if (uploaded) uploaded.value.needsUpdate = true;
  }
}
