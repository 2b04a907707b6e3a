// Redundant copies of Gaussians in the side information, drawn where packets are lost. Counterpart of
// `splatwire.codec.gaussians.copies`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import type { Growth } from "../../conceal/scene_free.ts";
import { MAX_COPIES } from "../../packets/limits.ts";
import type { Splats } from "../splats.ts";
import { FastPacketDecoder } from "./native.ts";
import { readBlocks, type SideInfo } from "./side_info.ts";
import { toSplats } from "./to_splats.ts";

const VERSION = 1,
  GROWTH_UNIT = 64,
  SUBJECT = "section 'sketch'";

export interface RedundantGaussians {
  /** Index of each copied Gaussian, all different. */
  readonly indices: Int32Array;
  readonly splats: Splats;
  /** Growth of received Gaussians, fitted to these copies. */
  readonly growth: Growth;
}

/** Reads the copies of a stream of `count` Gaussians. Any bytes after the indices decode to some Gaussians. */
export function readRedundantGaussians(bytes: Uint8Array, info: SideInfo, count: number): RedundantGaussians {
  const reader = new ByteReader(bytes, SUBJECT),
    version = reader.u8();
  if (version !== VERSION) throw new BitstreamError(`${SUBJECT} has version ${version}, this version reads ${VERSION}`);
  const [size, opacity, trust] = [0, 1, 2].map(() => reader.u8() / GROWTH_UNIT),
    copies = reader.unsigned();
  if (copies < 1 || copies > Math.min(count, MAX_COPIES))
    throw new BitstreamError(
      `${SUBJECT}: ${copies} copies for ${count} Gaussians, not 1 to ${Math.min(count, MAX_COPIES)}`,
    );
  const here: SideInfo = { ...info, ...readBlocks(reader.blob(), 1) },
    indices = readIndices(reader, copies, count);
  const splats = toSplats(new FastPacketDecoder(here).decode(reader.rest(), 0, copies), here, 0);
  return { indices, splats, growth: { base: [size, opacity], trust } };
}

/** Reads the indices. Each has as many bits as the largest possible index, high bits first. */
function readIndices(reader: ByteReader, copies: number, count: number): Int32Array {
  const width = Math.max(32 - Math.clz32(count - 1), 1),
    bytes = reader.take(Math.ceil((copies * width) / 8)),
    indices = new Int32Array(copies);
  for (let bit = 0; bit < copies * width; bit++) {
    const at = Math.floor(bit / width);
    indices[at] = (indices[at] << 1) | ((bytes[bit >> 3] >> (7 - (bit & 7))) & 1);
  }
  if (indices.some((index) => index >= count) || new Set(indices).size < copies)
    throw new BitstreamError(`${SUBJECT}: an index of a copy is repeated or out of range`);
  return indices;
}
