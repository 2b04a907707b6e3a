// Anchors of one packet, whatever schema they were coded with: drawn by neural heads for each camera.

import type { Anchors } from "../model/anchors.ts";
import type { Camera } from "../model/camera.ts";
import type { Heads } from "../model/heads.ts";
import type { Packet } from "../packets/packet.ts";
import type { Part, Seen } from "./part.ts";

/** Anchors and their features, one anchor's after another's. */
export interface Known {
  readonly anchors: Anchors;
  readonly features: Float32Array;
}

export class AnchorPart implements Part {
  readonly anchors: Anchors;
  /** Features, until somebody looks; then what they say to the heads. */
  features: Float32Array | null;
  #hidden: Float32Array = new Float32Array();

  constructor(
    readonly packet: Packet | null,
    readonly ranks: Int32Array,
    { anchors, features }: Known,
    readonly heads: Heads,
  ) {
    this.anchors = anchors;
    this.features = features;
  }

  get count(): number {
    return this.ranks.length;
  }

  get places(): Int32Array {
    return this.ranks;
  }

  seen(camera: Camera): Seen {
    if (this.features) this.#hidden = this.heads.prepared(this.features);
    this.features = null;
    return this.heads.spawn(this.anchors, this.#hidden, camera);
  }
}

/** All ranks: first those of the given parts, in order, then the others; and how many are given. */
export function givenFirst(
  parts: readonly { readonly ranks: Int32Array }[],
  count: number,
): { ranks: Int32Array; end: number } {
  const known = new Uint8Array(count),
    ranks = new Int32Array(count);
  let end = 0;
  for (const part of parts) {
    ranks.set(part.ranks, end);
    end += part.ranks.length;
  }
  for (const rank of ranks.subarray(0, end)) known[rank] = 1;
  for (let rank = 0, at = end; rank < count; rank++) if (!known[rank]) ranks[at++] = rank;
  return { ranks, end };
}

/** Some of the sketched anchors. */
export function chosen({ anchors, features }: Known, which: Int32Array): Known {
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
