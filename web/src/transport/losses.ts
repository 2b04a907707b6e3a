// Which packets are shown where some are dropped on purpose.

/** What a person chose. */
export interface Choice {
  readonly concealer: string;
  /** Share of the packets that is dropped, in bursts of this mean length; 1 drops each on its own. */
  readonly dropped: number;
  readonly burst: number;
  readonly seed: number;
  /** Share of the packets that were sent by then, in the order in which they came. */
  readonly sent: number;
}

/** Whether each packet is shown. Without bursts a larger share drops more packets, and never another one instead. */
export function shownPackets(
  packets: readonly { readonly block: number; readonly lane: number }[],
  { dropped, burst, seed, sent }: Choice,
): boolean[] {
  const end = sent * packets.length,
    leave = 1 / Math.max(burst, dropped / (1 - dropped), 1),
    enter = (leave * dropped) / (1 - dropped);
  let lost = false;
  return packets.map(({ block, lane }, n) => {
    const chance = random(block, lane, seed);
    // Gilbert's model, in order of arrival
    lost = burst > 1 ? chance < (lost ? 1 - leave : n ? enter : dropped) : chance < dropped;
    return n < end && !lost;
  });
}

/** A number from 0 to 1 of a packet. */
function random(block: number, lane: number, seed: number): number {
  let hash = Math.imul(block + 1, 0x9e3779b1) ^ Math.imul(lane + 1, 0x85ebca6b) ^ Math.imul(seed + 1, 0xc2b2ae35);
  hash = Math.imul(hash ^ (hash >>> 15), 0x2c1b3c6d);
  hash = Math.imul(hash ^ (hash >>> 12), 0x297a2d39);
  return ((hash ^ (hash >>> 15)) >>> 0) / 2 ** 32;
}
