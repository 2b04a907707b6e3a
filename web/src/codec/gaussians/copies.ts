// Copies of some Gaussians in the side information, for where their packets are lost. The twin of
// `splatwire.codec.schemas.gaussians.copies`.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import type { Growth } from "../../conceal/scene_free.ts";
import { MAX_COPIES } from "../../packets/limits.ts";
import type { Splats } from "../splats.ts";
import { PacketDecoder } from "./packet.ts";
import { readBlocks, type SideInfo } from "./side_info.ts";
import { toSplats } from "./to_splats.ts";

const VERSION = 1,
  GROWTH_UNIT = 64,
  WHAT = "section 'sketch'";

export interface GaussianCopies {
  /** Which Gaussians these are, all different. */
  readonly places: Int32Array;
  readonly splats: Splats;
  /** How what arrived grows best where there are copies. */
  readonly growth: Growth;
}

/** Reads the copies of a stream of `count` Gaussians; any bytes behind the places decode to something. */
export function readCopies(bytes: Uint8Array, info: SideInfo, count: number): GaussianCopies {
  const reader = new ByteReader(bytes, WHAT),
    version = reader.u8();
  if (version !== VERSION) throw new BitstreamError(`${WHAT} has version ${version}, this page reads ${VERSION}`);
  const [size, opacity, trust] = [0, 1, 2].map(() => reader.u8() / GROWTH_UNIT),
    copies = reader.unsigned();
  if (copies < 1 || copies > Math.min(count, MAX_COPIES))
    throw new BitstreamError(`${WHAT}: ${copies} copies of ${count} Gaussians are impossible`);
  const here: SideInfo = { ...info, ...readBlocks(reader.blob(), 1) },
    places = readPlaces(reader, copies, count);
  const splats = toSplats(new PacketDecoder(here).decode(reader.rest(), 0, copies), here, 0);
  return { places, splats, growth: { base: [size, opacity], trust } };
}

/** Each in as many bits as the last place takes, the high ones first. */
function readPlaces(reader: ByteReader, copies: number, count: number): Int32Array {
  const width = Math.max(32 - Math.clz32(count - 1), 1),
    bytes = reader.take(Math.ceil((copies * width) / 8)),
    places = new Int32Array(copies);
  for (let bit = 0; bit < copies * width; bit++) {
    const at = Math.floor(bit / width);
    places[at] = (places[at] << 1) | ((bytes[bit >> 3] >> (7 - (bit & 7))) & 1);
  }
  if (places.some((place) => place >= count) || new Set(places).size < copies)
    throw new BitstreamError(`${WHAT}: places of copies are not those of different Gaussians`);
  return places;
}
