// Packet plan of a stream, and the received packets.

import { BitstreamError } from "../bytes.ts";
import type { Manifest } from "./manifest.ts";
import { type Packet, readPacket, withoutBytes } from "./packet.ts";
import { splitmix, splitmixModulo } from "./splitmix64.ts";

interface Span {
  readonly first: number;
  readonly count: number;
  readonly blockSize: number;
  readonly lanes: number;
  readonly firstBlock: number;
  readonly numBlocks: number;
}

/** Counts the elements of each lane among `size` elements from `first` on. `seed` has a low and a high half. */
export function countLanes(
  first: number,
  size: number,
  [low, high]: readonly [number, number],
  lanes: number,
): Int32Array {
  const counts = new Int32Array(lanes);
  for (let rank = first; rank < first + size; rank++) counts[splitmixModulo((rank ^ low) >>> 0, high, lanes)]++;
  return counts;
}

/** Blocks and packets of a stream, derived from its manifest. */
export class Plan {
  readonly numBlocks: number;
  readonly #spans: Span[] = [];
  readonly #lanes = new Map<number, Int32Array>();
  readonly #orders = new Map<number, Int32Array>();

  constructor(
    readonly manifest: Manifest,
    readonly laneCounter = countLanes,
  ) {
    const { blockSize, lanes } = manifest.packetization;
    const tierCounts = manifest.tiers.length ? manifest.tiers : [{ count: manifest.count, lanes }];
    let first = 0,
      firstBlock = 0;
    for (const { count, lanes } of tierCounts) {
      const numBlocks = Math.ceil(count / blockSize);
      const size = manifest.tiers.length ? Math.ceil(count / Math.max(numBlocks, 1)) : blockSize;
      this.#spans.push({ first, count, blockSize: size, lanes, firstBlock, numBlocks });
      first += count;
      firstBlock += numBlocks;
    }
    this.numBlocks = firstBlock;
  }

  /** First block and number of blocks of each tier. */
  get tiers(): readonly Pick<Span, "firstBlock" | "numBlocks">[] {
    return this.#spans;
  }

  /** Returns the number of elements of a block. */
  numElementsOf(block: number): number {
    const span = this.#span(block);
    return Math.min(span.blockSize, span.count - (block - span.firstBlock) * span.blockSize);
  }

  /**
   * Returns the largest number of elements in a packet, 0 if the packet does not exist. With fixed grouping it is the
   * exact number.
   */
  capacity(block: number, indexInBlock: number): number {
    if (block >= this.numBlocks) return 0;
    if (this.manifest.packetization.grouping === "hashed") return Math.max(0, this.numElementsOf(block) - indexInBlock);
    return indexInBlock < this.#span(block).lanes ? this.#laneCounts(block)[indexInBlock] : 0;
  }

  /** Returns True if a packet has the size and the number of elements that its block and index allow. */
  fits({ block, indexInBlock, count, bytes }: Packet): boolean {
    const { grouping, packetBytes } = this.manifest.packetization,
      room = this.capacity(block, indexInBlock);
    return (grouping === "hashed" ? count <= room : count === room) && bytes.length <= packetBytes;
  }

  /** Returns the indices of a packet's elements, in ascending order or in the order of their hashes. */
  members({ block, indexInBlock, count }: Pick<Packet, "block" | "indexInBlock" | "count">): Int32Array {
    const isHashed = this.manifest.packetization.grouping === "hashed",
      first = isHashed
        ? indexInBlock
        : this.#laneCounts(block).reduce((sum, size, n) => (n < indexInBlock ? sum + size : sum), 0);
    return this.elementsOf(block).subarray(first, first + count);
  }

  /**
   * Returns the indices of a block's elements, packet by packet, or in the order of their hashes, so that any run of
   * them is spread over the block. They are kept: each packet of a block would need another pass over the block.
   */
  elementsOf(block: number): Int32Array {
    const known = this.#orders.get(block);
    if (known) return known;
    const { grouping, seed } = this.manifest.packetization,
      [low, high] = seed,
      { first, firstBlock, blockSize, lanes } = this.#span(block),
      start = first + (block - firstBlock) * blockSize,
      order = Int32Array.from({ length: this.numElementsOf(block) }, (_, n) => start + n);
    if (grouping === "hashed") {
      const hashes = Array.from(order, (index) => splitmix((index ^ low) >>> 0, high));
      order.sort((a, b) => hashes[a - start][1] - hashes[b - start][1] || hashes[a - start][0] - hashes[b - start][0]);
    } else if (grouping === "stratified") {
      let end = 0;
      const next = this.#laneCounts(block).map((size) => (end += size) - size);
      for (let n = 0; n < order.length; n++)
        order[next[splitmixModulo(((start + n) ^ low) >>> 0, high, lanes)]++] = start + n;
    }
    this.#orders.set(block, order);
    return order;
  }

  /** Returns the tier of a block. Uses bisection because clips have thousands of tiers. */
  tierOf(block: number): number {
    if (!(block >= 0 && block < this.numBlocks)) throw new BitstreamError(`block ${block} does not exist`);
    let low = 0,
      high = this.#spans.length;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.#spans[middle].firstBlock <= block) low = middle;
      else high = middle;
    }
    return low;
  }

  /** True for blocks of keyframe Gaussians. In clips, each group of frames has two tiers: keyframes, then motion. */
  isKeyframe(block: number): boolean {
    return this.tierOf(block) % 2 === 0;
  }

  /** Returns the group of frames of a block. Only for clips. */
  gopOf(block: number): number {
    return this.tierOf(block) >> 1;
  }

  #span(block: number): Span {
    return this.#spans[this.tierOf(block)];
  }

  #laneCounts(block: number): Int32Array {
    const known = this.#lanes.get(block);
    if (known) return known;
    const span = this.#span(block),
      size = this.numElementsOf(block),
      { grouping, seed } = this.manifest.packetization,
      counts =
        grouping === "contiguous"
          ? Int32Array.from(
              { length: span.lanes },
              (_, lane) => Math.floor(size / span.lanes) + (lane < size % span.lanes ? 1 : 0),
            )
          : this.laneCounter(span.first + (block - span.firstBlock) * span.blockSize, size, seed, span.lanes);
    this.#lanes.set(block, counts);
    return counts;
  }
}

const plans = new WeakMap<Manifest, Plan>();

/** Returns the shared plan of a manifest. `laneCounter` counts the elements of lanes, as `countLanes` does. */
export function planOf(manifest: Manifest, laneCounter = countLanes): Plan {
  let plan = plans.get(manifest);
  if (!plan) plans.set(manifest, (plan = new Plan(manifest, laneCounter)));
  return plan;
}

/** Valid packets of one stream. Invalid and duplicate packets are only counted. */
export class Intake {
  readonly counts = { corrupt: 0, duplicate: 0 };
  /** Packets of each block, sorted by index in the block. */
  readonly blocks = new Map<number, Packet[]>();
  size = 0;

  constructor(public plan: Plan) {}

  /** Releases the payloads of some blocks' packets but remembers that the packets were received. */
  forget(blocks: Iterable<number>): void {
    for (const block of blocks)
      for (const [n, packet] of (this.blocks.get(block) ?? []).entries())
        this.blocks.get(block)![n] = withoutBytes(packet);
  }

  get complete(): boolean {
    return this.size === this.plan.manifest.numPackets;
  }

  /** Adds a packet and returns it. Returns null if it is invalid or a duplicate. */
  offer(bytes: Uint8Array): Packet | null {
    const packet = readPacket(bytes, this.plan.manifest.streamId);
    if (!packet || !this.plan.fits(packet)) {
      this.counts.corrupt++;
      return null;
    }
    return this.admit(packet);
  }

  /**
   * Adds an intact packet that fits the plan and returns it. Returns null if it is a duplicate or contradicts another
   * one.
   */
  admit(packet: Packet): Packet | null {
    const { manifest } = this.plan;
    let list = this.blocks.get(packet.block);
    if (!list) this.blocks.set(packet.block, (list = []));
    let at = list.length;
    while (at > 0 && list[at - 1].indexInBlock >= packet.indexInBlock) at--;
    if (at < list.length && list[at].indexInBlock === packet.indexInBlock) {
      this.counts[list[at].count === packet.count ? "duplicate" : "corrupt"]++;
      return null;
    }
    const hashed = manifest.packetization.grouping === "hashed";
    const overlaps =
      (at > 0 && list[at - 1].indexInBlock + list[at - 1].count > packet.indexInBlock) ||
      (at < list.length && packet.indexInBlock + packet.count > list[at].indexInBlock);
    if ((hashed && overlaps) || this.size >= manifest.numPackets) {
      this.counts.corrupt++;
      return null;
    }
    list.splice(at, 0, packet);
    this.size++;
    return packet;
  }
}
