// `splatwire/three`: Gaussians for three.js, drawn by Spark (https://sparkjs.dev) together with meshes.

import { ExtSplats, utils } from "@sparkjsdev/spark";

import { type Gaussians, type ReceivedUpdate, type ReceiveOptions, receive } from "../decoder.ts";
import { withoutQuery } from "../transport/http_error.ts";
import { warnOfMissing } from "./losses.ts";
import { coefficientSlots } from "./spark_harmonics.ts";

export { ClipMesh } from "./three_clip.ts";

/**
 * Returns Gaussians for Spark: `new SplatMesh({ splats: splatsOf(gaussians) })`. Keeps the axes of the stream, where y
 * usually points down.
 */
export function splatsOf(gaussians: Gaussians): ExtSplats {
  const { count, degree, centres, rotations, scales, opacities, colours } = gaussians,
    length = 4 * utils.getTextureSize(Math.max(count, 1)).maxSplats,
    arrays: [Uint32Array, Uint32Array] = [new Uint32Array(length), new Uint32Array(length)];
  for (let i = 0; i < count; i++) {
    const [x, y, z] = centres.subarray(3 * i, 3 * i + 3),
      [sx, sy, sz] = scales.subarray(3 * i, 3 * i + 3),
      [qw, qx, qy, qz] = rotations.subarray(4 * i, 4 * i + 4),
      [r, g, b] = colours.subarray(3 * i, 3 * i + 3);
    utils.encodeExtSplat(arrays, i, x, y, z, sx, sy, sz, qx, qy, qz, qw, opacities[i], r, g, b);
  }
  const extra = degree > 0 ? harmonicsOf(gaussians, length) : {};
  return new ExtSplats({ extArrays: arrays, numSplats: count, extra });
}

/** Returns the blur options of a `SparkRenderer` for Gaussians or a clip. Spark's defaults assume antialiased ones. */
export const blurOf = ({
  antialiased,
}: {
  readonly antialiased: boolean;
}): { preBlurAmount: number; blurAmount: number } =>
  antialiased ? { preBlurAmount: 0, blurAmount: 0.3 } : { preBlurAmount: 0.3, blurAmount: 0 };

function harmonicsOf({ count, degree, harmonics }: Gaussians, length: number): Record<string, Uint32Array> {
  const number = (degree + 1) ** 2 - 1,
    found: Record<string, Uint32Array> = {};
  for (const [j, [name, word]] of coefficientSlots(degree).entries()) {
    const texels = (found[name] ??= new Uint32Array(length));
    for (let i = 0; i < count; i++) {
      const at = 3 * (i * number + j);
      texels[4 * i + word] = utils.encodeExtRgb(harmonics[at], harmonics[at + 1], harmonics[at + 2]);
    }
  }
  return found;
}

/** Loads a whole stream. The default concealer is `grow`. Missing packets are reported on the console. */
export async function loadSplats(url: string | URL, options: ReceiveOptions = {}): Promise<ExtSplats> {
  let last: ReceivedUpdate | null = null;
  const concealer = options.concealer ?? "grow";
  for await (const update of receive(url, { ...options, concealer })) last = update;
  const name = withoutQuery(String(url));
  if (!last) throw new Error(`nothing arrived from ${name}`);
  warnOfMissing(last, name);
  return splatsOf(last.gaussians);
}
