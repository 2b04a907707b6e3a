// Tiles of a scene with levels. Counterpart of `splatwire.bitstream.tiles` and `splatwire.bitstream.tile_index`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { MAX_PACKET_BYTES } from "../../packets/limits.ts";
import type { Plan } from "../../packets/plan.ts";
import { TILES } from "../../packets/section_names.ts";
import type { SideInfo } from "../gaussians/side_info.ts";

/** Tiles of a scene. The index of a tile is its block; the coarsest level has the smallest indices. */
export interface Tiles {
  readonly count: number;
  /** Parent (coarser tile) of each tile; -1 in the coarsest level. */
  readonly parents: Int32Array;
  /** Children (finer tiles) of each tile. */
  readonly children: readonly (readonly number[])[];
  readonly numGaussians: Int32Array;
  readonly numPackets: Int32Array;
  /** Index of each tile's first packet and offset of its first byte, counted from the end of the side information. */
  readonly firstPackets: Float64Array;
  readonly offsets: Float64Array;
  /**
   * Root mean square distance of the children's Gaussians to their representatives, world units; 0 in the finest level.
   */
  readonly errors: Float64Array;
  /** Bounding boxes of the centres, shape (count, 3), world units. */
  readonly low: Float64Array;
  readonly high: Float64Array;
}

export function readTiles(info: SideInfo, plan: Plan): Tiles {
  const section = info.sections.get(TILES);
  if (!section) throw new BitstreamError("the stream has no index of tiles");
  const count = plan.numBlocks,
    levels = plan.tiers,
    coarser = levels[levels.length - 1].firstBlock,
    reader = new ByteReader(section, "index of tiles");
  if (reader.left < 2 * count + 4 * coarser)
    throw new BitstreamError(`index of tiles: ${reader.left} bytes are too few for ${count} tiles`);
  const packets = Array.from({ length: count }, () => reader.unsigned()),
    sizes = Array.from({ length: count }, () => reader.unsigned()),
    errors = Float64Array.from({ length: count }, (_, tile) => (tile < coarser ? reader.f32() : 0));
  reader.finish();
  if (packets.reduce((sum, some) => sum + some, 0) !== plan.manifest.numPackets)
    throw new BitstreamError("index of tiles: its number of packets is not that of the manifest");
  if (sizes.some((size) => size > MAX_PACKET_BYTES)) throw new BitstreamError("index of tiles: a tile is too large");
  if (!errors.every((error) => error >= 0 && error < Infinity))
    throw new BitstreamError("index of tiles: an error is negative or not finite");
  const parents = new Int32Array(count).fill(-1);
  for (let n = 1; n < levels.length; n++) {
    const above = levels[n - 1],
      here = levels[n];
    for (let child = 0; child < here.numBlocks; child++)
      parents[here.firstBlock + child] =
        above.firstBlock + Math.floor(((2 * child + 1) * above.numBlocks) / (2 * here.numBlocks));
  }
  return {
    count,
    parents,
    children: childrenOf(parents),
    numGaussians: Int32Array.from({ length: count }, (_, tile) => plan.numElementsOf(tile)),
    numPackets: Int32Array.from(packets),
    firstPackets: cumulativeSums(packets),
    offsets: cumulativeSums(sizes),
    errors,
    ...corners(info, count),
  };
}

function childrenOf(parents: Int32Array): number[][] {
  const children: number[][] = Array.from(parents, () => []);
  parents.forEach((parent, tile) => parent >= 0 && children[parent].push(tile));
  return children;
}

/** Returns the cumulative sums, beginning with 0. */
function cumulativeSums(values: readonly number[]): Float64Array {
  const sums = new Float64Array(values.length + 1);
  values.forEach((value, n) => (sums[n + 1] = sums[n] + value));
  return sums;
}

function corners({ boxes, sizeLog, latticeBits }: SideInfo, count: number): Pick<Tiles, "low" | "high"> {
  const scale = 2 ** (sizeLog - latticeBits),
    high = (n: number): number => boxes.corners[n] + (boxes.extents[n] + 1) * 2 ** boxes.shifts[Math.floor(n / 3)];
  return {
    low: Float64Array.from({ length: 3 * count }, (_, n) => boxes.corners[n] * scale),
    high: Float64Array.from({ length: 3 * count }, (_, n) => high(n) * scale),
  };
}
