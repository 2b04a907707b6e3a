// Simulated packet losses.

/** Settings of the simulated losses and the concealer. */
export interface LossSimulation {
  readonly concealer: string;
  /** Loss rate, and mean burst length in packets. A burst length of 1 means independent losses. */
  readonly dropped: number;
  readonly burst: number;
  readonly seed: number;
  /** Share of the packets that were sent so far, in order of arrival. */
  readonly sent: number;
}

/** Returns a mask of the packets that are not lost. Without bursts, a larger loss rate loses a superset. */
export function shownPackets(
  packets: readonly { readonly block: number; readonly indexInBlock: number }[],
  { dropped, burst, seed, sent }: LossSimulation,
): boolean[] {
  const end = sent * packets.length,
    leave = 1 / Math.max(burst, dropped / (1 - dropped), 1),
    enter = (leave * dropped) / (1 - dropped);
  let lost = false;
  return packets.map(({ block, indexInBlock }, n) => {
    const chance = random(block, indexInBlock, seed);
    // Gilbert model, in order of arrival
    lost = burst > 1 ? chance < (lost ? 1 - leave : n ? enter : dropped) : chance < dropped;
    return n < end && !lost;
  });
}

/** Returns a pseudo-random number in [0, 1) for a packet. */
function random(block: number, indexInBlock: number, seed: number): number {
  let hash =
    Math.imul(block + 1, 0x9e3779b1) ^ Math.imul(indexInBlock + 1, 0x85ebca6b) ^ Math.imul(seed + 1, 0xc2b2ae35);
  hash = Math.imul(hash ^ (hash >>> 15), 0x2c1b3c6d);
  hash = Math.imul(hash ^ (hash >>> 12), 0x297a2d39);
  return ((hash ^ (hash >>> 15)) >>> 0) / 2 ** 32;
}
