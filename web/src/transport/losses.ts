// Simulated packet losses.

/** Settings of the simulated losses and the concealer. */
export interface LossSimulation {
  readonly concealer: string;
  readonly lossRate: number;
  /** Mean number of packets that are lost in a row; 1 for independent losses. */
  readonly burstLength: number;
  readonly seed: number;
  /** Share of the packets that were sent so far, in order of arrival. */
  readonly sentShare: number;
}

/** Returns a mask of the packets that are sent and not lost. Without bursts, a larger loss rate loses a superset. */
export function keptPackets(
  packets: readonly { readonly block: number; readonly indexInBlock: number }[],
  { lossRate, burstLength, seed, sentShare }: LossSimulation,
): boolean[] {
  const end = sentShare * packets.length,
    leave = 1 / Math.max(burstLength, lossRate / (1 - lossRate), 1),
    enter = (leave * lossRate) / (1 - lossRate);
  let lost = false;
  return packets.map(({ block, indexInBlock }, n) => {
    const chance = random(block, indexInBlock, seed);
    // Gilbert model, in order of arrival
    lost = burstLength > 1 ? chance < (lost ? 1 - leave : n ? enter : lossRate) : chance < lossRate;
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
