// Where anchors are expected, and how large: what a concealer needs of them.

import type { Elements, Pause } from "../../conceal/conceal.ts";
import { worldPlaces } from "./anchors.ts";
import type { PacketDecoder } from "./packet.ts";
import { expectedPlace } from "./positions.ts";
import { LOG_BITS } from "./side_info.ts";

const AT_A_TIME = 256, SMALLEST = 1e-9, LEAST_SHARE = 0.05;

export class Expected {
  /** Where each anchor is expected, voxels from the origin, by rank; the first so many are known by now. */
  readonly #places: Int32Array;
  /** Logarithms of the three sizes that are expected there. */
  readonly #logs: Float64Array;
  #done = 0;
  #sizes: Float32Array | null = null;

  constructor(readonly packets: PacketDecoder, readonly count: number) {
    this.#places = new Int32Array(3 * count);
    this.#logs = new Float64Array(3 * count);
  }

  /** First the received anchors, of these ranks, then the lost ones; null where nobody waits any more. All lie where they are expected. */
  async elements(received: readonly Int32Array[], pause: Pause): Promise<Elements | null> {
    const sizes = await this.#expectedSizes(pause);
    if (!sizes) return null;
    const known = new Uint8Array(this.count), ranks = new Int32Array(this.count), places = new Int32Array(3 * this.count);
    const end = received.reduce((at, part) => (ranks.set(part, at), at + part.length), 0);
    for (const rank of ranks.subarray(0, end)) known[rank] = 1;
    known.reduce((at, there, rank) => (there ? at : ((ranks[at] = rank), at + 1)), end);
    ranks.forEach((rank, n) => places.set(this.#places.subarray(3 * rank, 3 * rank + 3), 3 * n));
    return {
      positions: worldPlaces(places, this.packets.info),
      sizes: Float32Array.from(ranks, (rank) => sizes[rank]),
      opacities: null,
      known: new Uint8Array(this.count).fill(1, 0, end),
      places: ranks,
      logScales: null,
    };
  }

  /** Geometric means of the sizes that are expected of all anchors, by rank: worked out once, a little at a time. */
  async #expectedSizes(pause: Pause): Promise<Float32Array | null> {
    while (this.#done < this.count) {
      if (!(await pause())) return null;
      this.#expectSome(this.#done, Math.min(this.#done + AT_A_TIME, this.count));
    }
    return (this.#sizes ??= meanSizes(this.#logs));
  }

  #expectSome(first: number, end: number): void {
    for (let rank = first; rank < end; rank++) this.#places.set(expectedPlace(this.packets.info.positions, rank), 3 * rank);
    this.#logs.set(this.packets.expectedLogs(this.#places.subarray(3 * first, 3 * end)), 3 * first);
    this.#done = end;
  }
}

/** A prediction may be far off: none is below a share of their median. */
function meanSizes(logs: Float64Array): Float32Array {
  const sizes = Float32Array.from(logs, (log) => 2 ** (log / 2 ** LOG_BITS));
  const typical = sizes.slice().sort()[(sizes.length - 1) >> 1] ?? 0, least = Math.max(LEAST_SHARE * typical, SMALLEST);
  const log = (at: number): number => Math.log(Math.max(sizes[at], least));
  return Float32Array.from({ length: sizes.length / 3 }, (_, n) => Math.exp((log(3 * n) + log(3 * n + 1) + log(3 * n + 2)) / 3));
}
