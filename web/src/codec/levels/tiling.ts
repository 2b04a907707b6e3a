// Interface of scenes with levels.

import type { Camera } from "../../model/camera.ts";
import type { ElementBatch } from "../element_batch.ts";
import type { Splats } from "../splats.ts";
import type { DrawUnits } from "./draw_units.ts";
import type { Tiles } from "./tiles.ts";

/** Drawn and missing tiles of a scene with levels. */
export interface Tiling {
  readonly tiles: Tiles;
  readonly wanted: readonly number[];
  /** Number of Gaussians in all levels but the finest, enough for a first view. */
  readonly baseCount: number;
  readonly drawUnits: DrawUnits;
  /** Drawing units of the current view. */
  readonly drawn: readonly number[];
  /** Maximum number of drawn Gaussians in a view. */
  budget: number;
  /** Selects tiles for a view, at most `budget` Gaussians. Returns true if the drawn units changed. */
  setCamera(camera: Camera | null, budget?: number): boolean;
  /** Returns the number of received packets of a unit's tile. */
  packetsOf(unit: number): number;
  /** Returns those packets, and the indices of their Gaussians that belong to the unit. */
  batchesOf(unit: number): readonly { readonly batch: ElementBatch; readonly which: Int32Array }[];
  /** Decodes the Gaussians of a unit. */
  splatsOf(unit: number): Splats[];
}
