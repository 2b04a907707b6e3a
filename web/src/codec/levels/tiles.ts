// Which tiles a scene with levels has: the twin of `splatwire.packets.tiles` and `splatwire.packets.tile_index`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { MAX_PACKET_BYTES } from "../../packets/limits.ts";
import type { Plan } from "../../packets/plan.ts";
import type { SideInfo } from "../gaussians/side_info.ts";

/** The tiles of a scene, by their block: those of the coarsest level first. */
export interface Tiles {
  readonly count: number;
  /** The coarser tile that stands for each; -1 in the coarsest level. */
  readonly parents: Int32Array;
  /** The finer tiles that each stands for. */
  readonly children: readonly (readonly number[])[];
  readonly gaussians: Int32Array;
  readonly packets: Int32Array;
  /** Where the packets and the bytes of each begin, behind the side information. */
  readonly firstPackets: Float64Array;
  readonly offsets: Float64Array;
  /** How far centres are from what stands for them, root of the mean square, world units; 0 in the finest level. */
  readonly errors: Float64Array;
  /** Corners of the boxes around centres, world units, three each. */
  readonly low: Float64Array;
  readonly high: Float64Array;
}

export function readTiles(info: SideInfo, plan: Plan): Tiles {
  const section = info.sections.get("tiles");
  if (!section) throw new BitstreamError("the stream has no index of tiles");
  const count = plan.numBlocks,
    levels = plan.levels,
    coarser = levels[levels.length - 1].firstBlock,
    reader = new ByteReader(section, "index of tiles");
  if (reader.left < 2 * count + 4 * coarser)
    throw new BitstreamError(`index of tiles: ${reader.left} bytes are too few for ${count} tiles`);
  const packets = Array.from({ length: count }, () => reader.unsigned()),
    sizes = Array.from({ length: count }, () => reader.unsigned()),
    errors = Float64Array.from({ length: count }, (_, tile) => (tile < coarser ? reader.f32() : 0));
  reader.finish();
  if (packets.reduce((sum, some) => sum + some, 0) !== plan.manifest.numPackets)
    throw new BitstreamError("index of tiles: other packets than the manifest has");
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
    gaussians: Int32Array.from({ length: count }, (_, tile) => plan.blockCount(tile)),
    packets: Int32Array.from(packets),
    firstPackets: sums(packets),
    offsets: sums(sizes),
    errors,
    ...corners(info, count),
  };
}

function childrenOf(parents: Int32Array): number[][] {
  const children: number[][] = Array.from(parents, () => []);
  parents.forEach((parent, tile) => parent >= 0 && children[parent].push(tile));
  return children;
}

/** Sums of what comes before each, and of all. */
function sums(values: readonly number[]): Float64Array {
  const found = new Float64Array(values.length + 1);
  values.forEach((value, n) => (found[n + 1] = found[n] + value));
  return found;
}

function corners({ boxes, sizeLog, unit }: SideInfo, count: number): Pick<Tiles, "low" | "high"> {
  const scale = 2 ** (sizeLog - unit),
    high = (n: number): number => boxes.corners[n] + (boxes.extents[n] + 1) * 2 ** boxes.shifts[Math.floor(n / 3)];
  return {
    low: Float64Array.from({ length: 3 * count }, (_, n) => boxes.corners[n] * scale),
    high: Float64Array.from({ length: 3 * count }, (_, n) => high(n) * scale),
  };
}
