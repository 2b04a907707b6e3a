// Which element is in which tier: a named section of the side information that only streams with tiers have.

import { BitstreamError } from "../bytes.ts";
import { RangeDecoder } from "../entropy/decoder.ts";
import type { Manifest } from "../packets/manifest.ts";

const COUNTS = 16,
  STATES = 4 * COUNTS;
/** Quantisation steps of sizes to an octave. */
const SIZE_STEPS = 8;

/** What tiers say of a stream's elements. */
export interface TierFacts {
  /** Rank of the element at each place of the plan; null where they are the same because there is one tier. */
  readonly order: Int32Array | null;
  /** How large elements of each one's tier are, by rank; null where the sender does not say. */
  readonly sizes: Float32Array | null;
}

export function tierFacts(sections: Map<string, Uint8Array>, manifest: Manifest): TierFacts {
  const tiers = readTiers(sections, manifest),
    sizes = readSizes(sections, manifest);
  return {
    order: tiers && ranksInOrder(tiers, manifest),
    sizes: sizes && tiers && Float32Array.from(tiers, (tier) => sizes[tier]),
  };
}

/** The tier of each element, by rank; null where there is one. */
function readTiers(sections: Map<string, Uint8Array>, { tiers: shapes, count }: Manifest): Uint8Array | null {
  const section = sections.get("tiers");
  if ((section !== undefined) !== shapes.length > 0)
    throw new BitstreamError("manifest and side information disagree on whether there are tiers");
  return section ? decodeTiers(section, count, shapes.length) : null;
}

/** Sizes of the tiers, the largest is 1. */
function readSizes(sections: Map<string, Uint8Array>, { tiers: shapes }: Manifest): Float32Array | null {
  const steps = sections.get("tier_sizes");
  if (!steps) return null;
  if (steps.length !== shapes.length)
    throw new BitstreamError(`section 'tier_sizes' has ${steps.length} bytes for ${shapes.length} tiers`);
  if (!steps.includes(0)) throw new BitstreamError("section 'tier_sizes': no tier is the largest");
  return Float32Array.from(steps, (step) => 2 ** (-step / SIZE_STEPS));
}

function ranksInOrder(tiers: Uint8Array, { tiers: shapes, count }: Manifest): Int32Array {
  const next = new Int32Array(shapes.length),
    order = new Int32Array(count);
  shapes.slice(0, -1).reduce((sum, shape, tier) => (next[tier + 1] = sum + shape.count), 0);
  const ends = shapes.map((shape, tier) => next[tier] + shape.count);
  tiers.forEach((tier, rank) => {
    if (next[tier] >= ends[tier]) throw new BitstreamError("the side information has tiers that the manifest denies");
    order[next[tier]++] = rank;
  });
  return order;
}

/** A run of bits for each element: is it tier 0, and if not, is it tier 1, ... */
function decodeTiers(bytes: Uint8Array, count: number, numTiers: number): Uint8Array {
  const coder = new RangeDecoder(bytes),
    models = new Int32Array(2 * (numTiers - 1) * STATES).fill(32768),
    tiers = new Uint8Array(count);
  const counts = new Int32Array(numTiers),
    recents = new Int32Array(numTiers);
  for (let n = 0; n < count; n++) {
    let found = numTiers - 1;
    for (let tier = 0; tier < numTiers - 1; tier++) {
      if (found === numTiers - 1 && coder.bit(models, context(tier, counts[tier], recents[tier]))) found = tier;
      const important = found <= tier;
      counts[tier] += ((important ? 65535 : 0) - counts[tier]) >> 3;
      recents[tier] = (2 * recents[tier] + (important ? 1 : 0)) & 3;
    }
    tiers[n] = found;
  }
  return tiers;
}

function context(tier: number, count: number, recent: number): number {
  let step = 0;
  for (let value = count >> 4; value && step < COUNTS - 1; step++) value = (value * 5) >> 3;
  return tier * STATES + 4 * step + recent;
}
