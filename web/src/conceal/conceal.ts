// How gaps are concealed: what arrived is drawn with a gain on its size.

import { grow } from "./grow.ts";

/** What is known of all elements of a scene, received or lost: lost ones lie and are as large as is expected of them. */
export interface Elements {
  /** x, y, z of each. */
  readonly positions: Float32Array;
  /** Geometric mean of each one's standard deviations. */
  readonly sizes: Float32Array;
  /** Of those that arrived. */
  readonly opacities: Float32Array;
  readonly known: Uint8Array;
}

/** Called now and then by what takes long, so that its thread can do other things; false where nobody waits any more. */
export type Pause = () => Promise<boolean>;

/** Gains of size and of opacity of each element in turn, which mean nothing for what is lost; null where nobody waits any more. */
export type Concealer = (elements: Elements, pause: Pause) => Promise<Float32Array | null>;

export const CONCEALERS: Readonly<Record<string, Concealer>> = {
  drop: (elements) => Promise.resolve(new Float32Array(2 * elements.known.length).fill(1)),
  grow,
};
