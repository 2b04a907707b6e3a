// What is drawn of a scene with levels.

import type { Camera } from "../../model/camera.ts";
import type { Part } from "../part.ts";
import type { Splats } from "../splats.ts";
import type { Pieces } from "./pieces.ts";
import type { Tiles } from "./tiles.ts";

/** Which tiles are drawn, and which are to be fetched. */
export interface Tiling {
  readonly tiles: Tiles;
  readonly wanted: readonly number[];
  /** Gaussians that are enough to look around. */
  readonly enough: number;
  readonly pieces: Pieces;
  /** Pieces that are drawn. */
  readonly drawn: readonly number[];
  /** Looks again, for so many Gaussians at most; true if other pieces are drawn than before. */
  look(camera: Camera | null, budget?: number): boolean;
  /** How many packets of the tile of a piece came. */
  packetsOf(piece: number): number;
  /** Those packets, and which of their Gaussians are those of the piece. */
  partsOf(piece: number): readonly { readonly part: Part; readonly which: Int32Array }[];
  /** The Gaussians of a piece, decoded anew. */
  splatsOf(piece: number): Splats[];
}
