// Importance tier of each element, stored in a named section of streams with tiers.

import { BitstreamError } from "../bytes.ts";
import { RangeDecoder } from "../entropy/decoder.ts";
import type { Manifest } from "../packets/manifest.ts";
import { TIER_SIZES, TIERS } from "../packets/section_names.ts";

const COUNTS = 16,
  STATES = 4 * COUNTS;
/** Quantisation steps of tier sizes per factor of two. */
const SIZE_STEPS = 8;

/** Order and sizes of a stream's elements, derived from its tiers. */
export interface TierLayout {
  /** Rank of the element at each place of the plan; null if there is one tier, where both are equal. */
  readonly order: Int32Array | null;
  /** Typical size of each element's tier, by rank; null if the stream does not contain it. */
  readonly sizes: Float32Array | null;
}

export function tierLayout(sections: Map<string, Uint8Array>, manifest: Manifest): TierLayout {
  const tiers = readTiers(sections, manifest),
    sizes = readSizes(sections, manifest);
  return {
    order: tiers && ranksInOrder(tiers, manifest),
    sizes: sizes && tiers && Float32Array.from(tiers, (tier) => sizes[tier]),
  };
}

/** Reads the tier of each element, by rank; null if there is one tier. */
function readTiers(sections: Map<string, Uint8Array>, { tiers: tierCounts, count }: Manifest): Uint8Array | null {
  const section = sections.get(TIERS);
  if ((section !== undefined) !== tierCounts.length > 0)
    throw new BitstreamError("only one of manifest and side information has tiers");
  return section ? decodeTiers(section, count, tierCounts.length) : null;
}

/** Reads the relative sizes of the tiers. The largest is 1. */
function readSizes(sections: Map<string, Uint8Array>, { tiers: tierCounts }: Manifest): Float32Array | null {
  const steps = sections.get(TIER_SIZES);
  if (!steps) return null;
  if (steps.length !== tierCounts.length)
    throw new BitstreamError(`section 'tier_sizes' has ${steps.length} bytes for ${tierCounts.length} tiers`);
  if (!steps.includes(0)) throw new BitstreamError("section 'tier_sizes': no tier is the largest");
  return Float32Array.from(steps, (step) => 2 ** (-step / SIZE_STEPS));
}

function ranksInOrder(tiers: Uint8Array, { tiers: tierCounts, count }: Manifest): Int32Array {
  const next = new Int32Array(tierCounts.length),
    order = new Int32Array(count);
  tierCounts.slice(0, -1).reduce((sum, { count }, tier) => (next[tier + 1] = sum + count), 0);
  const ends = tierCounts.map(({ count }, tier) => next[tier] + count);
  tiers.forEach((tier, rank) => {
    if (next[tier] >= ends[tier])
      throw new BitstreamError("the side information has more elements in a tier than the manifest");
    order[next[tier]++] = rank;
  });
  return order;
}

/** Decodes the tiers. Each element has one bit per tier until the bit is set. */
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
