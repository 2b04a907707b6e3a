// Decoded elements of a stream in order of arrival, the drawn part of them, and their gains under simulated losses.

import { StreamDecoder } from "../codec/decoder.ts";
import type { Copies, ElementBatch } from "../codec/element_batch.ts";
import type { DecodedPacket } from "../codec/element_decoder.ts";
import type { Verification } from "../codec/gaussians/digest.ts";
import { type Swap, swapsOf } from "../codec/levels/swaps.ts";
import type { Splats } from "../codec/splats.ts";
import { ANY_CAMERA, type Camera } from "../model/camera.ts";
import type { Head } from "../packets/container.ts";
import { identityOf, type Packet } from "../packets/packet.ts";
import type { Pause } from "../scheduler.ts";
import { keptPackets, type LossSimulation } from "./losses.ts";

/** Name of the concealer that draws redundant copies. */
const SKETCH = "sketch";

/** Gaussians to draw, part by part. */
export interface ShownGaussians {
  readonly parts: readonly Splats[];
  /** True to replace all drawn Gaussians, false to add to them. */
  readonly replaceAll: boolean;
  /** True if some are from packets that were not drawn before. */
  readonly hasNew: boolean;
  /** Number of elements that are drawn now, at least in part. */
  readonly elements: number;
  /** Number of redundant Gaussians among all that are drawn now. */
  readonly copies: number;
}

export class DecodedStream {
  readonly decoder: StreamDecoder;
  readonly #batches: ElementBatch[] = [];
  /** Index of the first element of each batch, in order of arrival. */
  readonly #firsts: number[] = [];
  #count = 0;
  /** Number of drawn batches, and the element of each drawn Gaussian; null if Gaussian n is element n. */
  #drawn = 0;
  #owners: Int32Array[] | null = null;
  /** Redundant copies among the batches, and the index of their first element. */
  #copies: (Copies & { readonly first: number }) | null = null;
  /** Number of drawn redundant Gaussians. */
  #drawnCopies = 0;
  /** Gains of size and opacity of the elements; null before the first concealment. */
  #gains: Float32Array | null = null;

  constructor(head: Head, verify: Verification = null) {
    this.decoder = new StreamDecoder(head, verify);
  }

  /** True if some elements are not drawn yet. */
  get hasNew(): boolean {
    return this.#drawn < this.#batches.length;
  }

  /** Decoded Gaussians of all packets, without redundant copies, in order of arrival. */
  get splats(): Splats[] {
    return this.#batches.filter((batch) => batch.packet).map((batch) => batch.forCamera(ANY_CAMERA).splats);
  }

  /**
   * Gaussians that determine the default viewpoint, in an order that does not depend on arrival. Null until all of them
   * were received, or if all Gaussians of the stream determine it.
   */
  get framingGaussians(): Splats[] | null {
    const { elementDecoder, intake } = this.decoder,
      { framingBlocks = 0 } = elementDecoder,
      found = this.#batches.filter(({ packet }) => packet && packet.block < framingBlocks);
    let missing = 0;
    for (let block = 0; block < framingBlocks; block++) missing += intake.plan.numElementsOf(block);
    for (const { count } of found) missing -= count;
    if (missing || !found.length) return null;
    found.sort((a, b) => identityOf(a.packet!) - identityOf(b.packet!)); // the viewpoint depends on a sample of them
    return found.map(({ splats }) => splats!);
  }

  /** True if redundant copies are among the drawn Gaussians. */
  get hasCopies(): boolean {
    return this.#copies !== null;
  }

  /** Adds one packet, and decodes it unless such packets are decoded only for drawing. */
  addPacket(bytes: Uint8Array): void {
    const batch = this.decoder.addPacket(bytes);
    if (batch) this.#push(batch);
  }

  /** Adds a packet that `decoder.admit` returned, once it is decoded; null to have it decoded here. */
  accept(packet: Packet, decoded: DecodedPacket | null): void {
    const { elementDecoder } = this.decoder;
    this.#push(decoded ? elementDecoder.accept!(packet, decoded) : elementDecoder.read(packet));
  }

  /**
   * Prepares the redundant copies if the concealer needs them. Throws `BitstreamError` for damaged copies, or if
   * concealment needs too much memory.
   */
  async prepare({ concealer }: LossSimulation, pause: Pause): Promise<void> {
    if (concealer !== "drop") this.decoder.checkConcealmentMemory();
    if (concealer !== SKETCH || this.#copies || !this.decoder.elementDecoder.concealers[concealer]) return;
    const copies = await this.decoder.elementDecoder.copies(pause);
    if (!copies || this.#copies) return;
    this.#copies = { ...copies, first: this.#count };
    this.#push(copies.batch);
  }

  #push(batch: ElementBatch): void {
    this.#batches.push(batch);
    this.#firsts.push(this.#count);
    this.#count += batch.count;
  }

  /**
   * Returns the Gaussians for a camera: all of them, or those of new packets. Resolves to null if the result is no
   * longer needed.
   */
  async gaussiansFor(camera: Camera, replaceAll: boolean, pause: Pause): Promise<ShownGaussians | null> {
    const { tiling } = this.decoder.elementDecoder;
    replaceAll = tiling?.setCamera(camera) || replaceAll; // the view has changed to other tiles
    const first = replaceAll ? 0 : this.#drawn,
      end = this.#batches.length,
      splats: Splats[] = [],
      owners: Int32Array[] = [];
    let numCopies = replaceAll ? 0 : this.#drawnCopies;
    for (let p = first; p < end; p++) {
      if (!(await pause())) return null;
      const batch = this.#batches[p],
        gaussians = batch.forCamera(camera);
      splats.push(gaussians.splats);
      if (batch === this.#copies?.batch) numCopies = gaussians.splats.count;
      if (gaussians.owners) owners.push(gaussians.owners.map((owner) => owner + this.#firsts[p]));
    }
    const hasNew = this.#drawn < end;
    this.#drawn = end;
    this.#drawnCopies = numCopies;
    if (this.decoder.elementDecoder.viewDependent)
      this.#owners = replaceAll ? owners : [...(this.#owners ?? []), ...owners];
    const numElements = this.#firsts[end] ?? this.#count,
      copies = this.#copies;
    return {
      parts: splats,
      replaceAll: replaceAll,
      hasNew,
      elements: numElements - (copies && copies.first < numElements ? copies.batch.count : 0),
      copies: numCopies,
    };
  }

  /**
   * Returns the steps from the drawn units (with their numbers of packets) to those of a camera. Each step shows every
   * part of the scene exactly once. A unit with new packets replaces itself.
   */
  swaps(camera: Camera, before: ReadonlyMap<number, number>): Swap[] {
    const tiling = this.decoder.elementDecoder.tiling!;
    tiling.setCamera(camera);
    this.#drawn = this.#batches.length;
    const drawn = new Set(tiling.drawn),
      grown = tiling.drawn.filter((unit) => tiling.packetsOf(unit) > (before.get(unit) ?? Infinity));
    return [
      ...swapsOf(tiling.drawUnits.parents, new Set(before.keys()), drawn),
      ...grown.map((unit) => ({ removed: [unit], added: [unit] })),
    ];
  }

  /** Returns the gains of the Gaussians of some units, in order; null before the first concealment. */
  gainsOfUnits(units: readonly number[]): Float32Array | null {
    const gains = this.#gains,
      batches = units.flatMap((unit) => this.decoder.elementDecoder.tiling!.batchesOf(unit));
    if (!gains) return null;
    const firsts = new Map(this.#batches.map((batch, p) => [batch, this.#firsts[p]])),
      all = new Float32Array(2 * batches.reduce((sum, { which }) => sum + which.length, 0)).fill(1);
    let at = 0;
    for (const { batch, which } of batches) {
      const first = firsts.get(batch)!;
      for (const n of which) {
        if (2 * (first + n) < gains.length) all.set(gains.subarray(2 * (first + n), 2 * (first + n + 1)), at);
        at += 2;
      }
    }
    return all;
  }

  /**
   * Computes the gains of all elements under simulated losses, 0 for lost ones. Resolves to the number of kept
   * packets, or to null if the result is no longer needed.
   */
  async conceal(simulation: LossSimulation, pause: Pause): Promise<number | null> {
    const gains = new Float32Array(2 * this.#count),
      { elementDecoder } = this.decoder;
    const received = this.#batches.flatMap((batch, p) =>
      batch.packet ? [{ batch, packet: batch.packet, first: this.#firsts[p] }] : [],
    );
    const kept = keptPackets(
        received.map(({ packet }) => packet),
        simulation,
      ),
      batches = received.filter((_, p) => kept[p]);
    const keptBatches = batches.map(({ batch }) => batch),
      copies = simulation.concealer === SKETCH ? this.#copies : null,
      which = this.#copiesOfMissing(keptBatches);
    const drawn = copies ? [...keptBatches, copies.select(which)] : keptBatches,
      count = drawn.reduce((sum, batch) => sum + batch.count, 0);
    const { concealers } = elementDecoder,
      isWhole = count === this.decoder.head.manifest.count,
      concealer = (!isWhole && concealers[simulation.concealer]) || concealers["drop"],
      concealerGains = await concealer(count, () => elementDecoder.elements(drawn, pause), pause);
    if (!concealerGains) return null;
    let at = 0;
    for (const { batch, first } of batches) {
      gains.set(concealerGains.subarray(2 * at, 2 * (at + batch.count)), 2 * first);
      at += batch.count;
    }
    if (copies)
      which.forEach((n, i) =>
        gains.set(concealerGains.subarray(2 * (at + i), 2 * (at + i + 1)), 2 * (copies.first + n)),
      );
    this.#gains = gains;
    return batches.length;
  }

  /** Returns the indices of the redundant copies of elements that are not in these batches. */
  #copiesOfMissing(batches: readonly ElementBatch[]): Int32Array {
    const copied = this.#copies?.batch.indices;
    if (!copied) return new Int32Array();
    const isReceived = new Uint8Array(this.decoder.head.manifest.count);
    for (const { indices } of batches) for (const index of indices) isReceived[index] = 1;
    return copied.map((_, n) => n).filter((n) => !isReceived[copied[n]]);
  }

  /** Gains of the drawn Gaussians, in their order. Elements that arrived after the last concealment have gain 1. */
  get gains(): Float32Array | null {
    return this.#gains && this.#gainsOfDrawn(this.#gains);
  }

  /** Gains of `splats`, in their order, after a concealment. */
  get gainsOfSplats(): Float32Array {
    const { first = 0, batch = null } = this.#copies ?? {};
    return this.#gains!.filter((_, n) => !batch || n < 2 * first || n >= 2 * (first + batch.count));
  }

  /** Gains that hide only the redundant Gaussians; null if there are none. */
  get gainsWithoutCopies(): Float32Array | null {
    const copies = this.#copies;
    if (!copies) return null;
    const gains = new Float32Array(2 * this.#count).fill(1);
    return this.#gainsOfDrawn(gains.fill(0, 2 * copies.first, 2 * (copies.first + copies.batch.count)));
  }

  /** Maps the gains of elements to the drawn Gaussians. */
  #gainsOfDrawn(gains: Float32Array): Float32Array {
    const owners = this.#owners;
    if (!owners) return gains.slice();
    const all = new Float32Array(2 * owners.reduce((sum, piece) => sum + piece.length, 0)).fill(1);
    let at = 0;
    for (const piece of owners) {
      for (const owner of piece) {
        if (2 * owner < gains.length) all.set(gains.subarray(2 * owner, 2 * owner + 2), at);
        at += 2;
      }
    }
    return all;
  }
}
