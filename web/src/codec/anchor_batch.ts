// Anchors of one packet, of any codec. Neural heads derive their Gaussians for each camera.

import type { Anchors } from "../model/anchors.ts";
import type { Camera } from "../model/camera.ts";
import type { Heads } from "../model/heads.ts";
import type { Packet } from "../packets/packet.ts";
import type { ElementBatch, ViewGaussians } from "./element_batch.ts";

/** Anchors and their feature vectors, shape (count, featureDim). */
export interface AnchorData {
  readonly anchors: Anchors;
  readonly features: Float32Array;
}

export class AnchorBatch implements ElementBatch {
  readonly anchors: Anchors;
  /** Feature vectors until the first view is requested, then null. `#hidden` replaces them. */
  features: Float32Array | null;
  #hidden: Float32Array = new Float32Array();

  constructor(
    readonly packet: Packet | null,
    readonly ranks: Int32Array,
    { anchors, features }: AnchorData,
    readonly heads: Heads,
  ) {
    this.anchors = anchors;
    this.features = features;
  }

  get count(): number {
    return this.ranks.length;
  }

  get indices(): Int32Array {
    return this.ranks;
  }

  forCamera(camera: Camera): ViewGaussians {
    if (this.features) this.#hidden = this.heads.featureActivations(this.features);
    this.features = null;
    return this.heads.spawn(this.anchors, this.#hidden, camera);
  }
}

/** Returns all ranks, first those of the given batches in order, then the others. `end` is the number of given ones. */
export function receivedRanksFirst(
  batches: readonly { readonly ranks: Int32Array }[],
  count: number,
): { ranks: Int32Array; numReceived: number } {
  const known = new Uint8Array(count),
    ranks = new Int32Array(count);
  let end = 0;
  for (const batch of batches) {
    ranks.set(batch.ranks, end);
    end += batch.ranks.length;
  }
  for (const rank of ranks.subarray(0, end)) known[rank] = 1;
  for (let rank = 0, at = end; rank < count; rank++) if (!known[rank]) ranks[at++] = rank;
  return { ranks, numReceived: end };
}

/** Returns a selection of anchors. */
export function selectAnchors({ anchors, features }: AnchorData, which: Int32Array): AnchorData {
  const some = <A extends Float32Array | Uint8Array>(values: A): A => {
    const width = values.length / Math.max(anchors.count, 1),
      found = new (values.constructor as new (size: number) => A)(width * which.length);
    which.forEach((from, to) => found.set(values.subarray(width * from, width * (from + 1)), width * to));
    return found;
  };
  const { positions, scales, sizes, masks, offsets, numOffsets } = anchors;
  return {
    anchors: {
      count: which.length,
      numOffsets,
      positions: some(positions),
      scales: some(scales),
      sizes: some(sizes),
      masks: some(masks),
      offsets: some(offsets),
    },
    features: some(features),
  };
}
