// Previews in the layout of GPU textures.

import { readPreview } from "../codec/preview.ts";
import { type Packed, pack } from "./packed.ts";

/** Gaussians of a preview in front of a background colour. */
export interface PackedPreview {
  readonly packed: Packed;
  readonly background: readonly [number, number, number];
  /** Unit of length, world units. */
  readonly size: number;
}

/** Parses and packs a preview. Throws `BitstreamError` for an invalid one. */
export function packPreview(bytes: Uint8Array): PackedPreview {
  const { splats, background, spread: size } = readPreview(bytes);
  return { packed: pack([splats], 0, size), background, size };
}
