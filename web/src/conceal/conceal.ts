// How gaps are concealed: what arrived is drawn with a gain on its size.

import { grow } from "./grow.ts";
import { sceneFree } from "./scene_free.ts";
import { sceneFreeAnchors } from "./scene_free_anchors.ts";

/**
 * What is known of all elements of a scene, received or lost: lost ones lie and are as large as is expected of them.
 */
export interface Elements {
  /** x, y, z of each. */
  readonly positions: Float32Array;
  /** Each one's size: what it counts for among its neighbours, unless that of its tier is known. */
  readonly sizes: Float32Array;
  /** How large elements of each one's tier are; null where the sender does not say. */
  readonly tierSizes: Float32Array | null;
  /** Of those that arrived; null where an element has no opacity of its own. */
  readonly opacities: Float32Array | null;
  readonly known: Uint8Array;
  /** Which elements of the scene they are: of those that are equally far from one, the first counts. */
  readonly places: Int32Array;
  /** Logarithms of the axes of received Gaussians, largest first; null for anchors. */
  readonly logScales: Float32Array | null;
  /** What there is to know of received anchors, the first elements; null for explicit Gaussians. */
  readonly anchors: (() => AnchorFacts) | null;
}

export interface AnchorFacts {
  /** Logarithms of the unit of each one's offsets and of its three sizes. */
  readonly logs: Float64Array;
  /** How many Gaussians each has. */
  readonly active: Uint8Array;
  /**
   * Logarithms of how far features are expected to be off, in their spreads, and lengths, in what is expected of them.
   */
  readonly unsure: Float64Array;
}

/**
 * Called now and then by what takes long, so that its thread can do other things; false where nobody waits any more.
 */
export type Pause = () => Promise<boolean>;

/**
 * Gains of size and of opacity of each received element in turn; null where nobody waits any more. What is known of all
 * elements is asked for by those that need it, received ones first.
 */
export type Concealer = (
  received: number,
  elements: () => Promise<Elements | null>,
  pause: Pause,
) => Promise<Float32Array | null>;

/** One that looks at what is known of all elements. */
export const grown =
  (gains: (all: Elements, pause: Pause) => Promise<Float32Array | null>): Concealer =>
  async (received, elements, pause) => {
    const all = await elements();
    return all && ((await gains(all, pause))?.subarray(0, 2 * received) ?? null);
  };

/** Those that work on any elements. */
export const CONCEALERS: Readonly<Record<string, Concealer>> = {
  drop: (received) => Promise.resolve(new Float32Array(2 * received).fill(1)),
  grow: grown(grow),
};

export const SPLAT_CONCEALERS: Readonly<Record<string, Concealer>> = { ...CONCEALERS, scene_free: grown(sceneFree) };
export const ANCHOR_CONCEALERS: Readonly<Record<string, Concealer>> = {
  ...CONCEALERS,
  scene_free: grown(sceneFreeAnchors),
};
