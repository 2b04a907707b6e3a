// How gaps are concealed: what arrived is drawn with a gain on its size.

import type { Pause } from "../turns.ts";
import type { Elements } from "./elements.ts";
import { grow } from "./grow.ts";
import { sceneFree } from "./scene_free.ts";
import { sceneFreeAnchors } from "./scene_free_anchors.ts";

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
