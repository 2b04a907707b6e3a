// Decoded elements of a packet.

import type { Camera } from "../model/camera.ts";
import type { Packet } from "../packets/packet.ts";
import type { Splats } from "./splats.ts";

/** Gaussians, and the element of each; null where each element is one, in order. */
export interface Seen {
  readonly splats: Splats;
  readonly owners: Int32Array | null;
}

/** Elements of one packet, as they were received, or copies of some. */
export interface Part {
  /** None of copies. */
  readonly packet: Packet | null;
  readonly count: number;
  /** Which elements of the scene they are. */
  readonly places: Int32Array;
  /** What a camera sees of them; where elements look the same to all, the camera does not matter. */
  seen(camera: Camera): Seen;
}

/** Copies of elements that a sender left, to be drawn where those are lost. */
export interface Copies<P extends Part = Part> {
  readonly part: P;
  /** Some of them, as `Schema.elements` takes them. */
  chosen(which: Int32Array): P;
}
