// Concealers: gains of size and opacity for the received elements.

import type { Pause } from "../scheduler.ts";
import type { Elements } from "./elements.ts";
import { grow } from "./grow.ts";
import { sceneFree } from "./scene_free.ts";
import { sceneFreeAnchors } from "./scene_free_anchors.ts";

/**
 * Computes gains, shape (received, 2), of size and opacity. Resolves to null if the result is no longer needed.
 *
 * `elements` provides the properties of all elements, received ones first. Concealers that do not call it cost no
 * memory.
 */
export type Concealer = (
  received: number,
  elements: () => Promise<Elements | null>,
  pause: Pause,
) => Promise<Float32Array | null>;

/** Makes a concealer from a function of all elements' properties. */
export const fromElements =
  (gains: (all: Elements, pause: Pause) => Promise<Float32Array | null>): Concealer =>
  async (received, elements, pause) => {
    const all = await elements();
    return all && ((await gains(all, pause))?.subarray(0, 2 * received) ?? null);
  };

/** Concealers for any kind of elements. */
export const CONCEALERS: Readonly<Record<string, Concealer>> = {
  drop: (received) => Promise.resolve(new Float32Array(2 * received).fill(1)),
  grow: fromElements(grow),
};

export const SPLAT_CONCEALERS: Readonly<Record<string, Concealer>> = {
  ...CONCEALERS,
  scene_free: fromElements(sceneFree),
};
export const ANCHOR_CONCEALERS: Readonly<Record<string, Concealer>> = {
  ...CONCEALERS,
  scene_free: fromElements(sceneFreeAnchors),
};
