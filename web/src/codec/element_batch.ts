// Decoded elements of a packet.

import type { Camera } from "../model/camera.ts";
import type { Packet } from "../packets/packet.ts";
import type { Splats } from "./splats.ts";

/** Gaussians of a view, and the index of each one's element. `owners` is null if Gaussian n is element n. */
export interface ViewGaussians {
  readonly splats: Splats;
  readonly owners: Int32Array | null;
}

/** Elements of one packet, or redundant copies of elements. */
export interface ElementBatch {
  /** The packet; null for redundant copies. */
  readonly packet: Packet | null;
  readonly count: number;
  /** Index of each element in the scene. */
  readonly indices: Int32Array;
  /** All Gaussians, whether drawn or not; absent if they depend on the camera. */
  readonly splats?: Splats;
  /** Returns the Gaussians for a camera. The camera has no effect for explicit Gaussians. */
  forCamera(camera: Camera): ViewGaussians;
}

/** Redundant copies from the side information, drawn in place of lost elements. */
export interface Copies<P extends ElementBatch = ElementBatch> {
  readonly batch: P;
  /** Returns a selection of the copies for `ElementDecoder.elements`. */
  select(which: Int32Array): P;
}
