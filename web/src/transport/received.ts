// The elements of a transfer in the order in which they came, what of them is drawn, and what is left where packets are
// dropped on purpose.

import { StreamDecoder } from "../codec/decoder.ts";
import { type Swap, swapsOf } from "../codec/levels/swaps.ts";
import type { Copies, Part } from "../codec/part.ts";
import type { Splats } from "../codec/splats.ts";
import type { Camera } from "../model/camera.ts";
import type { Head } from "../packets/container.ts";
import type { Pause } from "../turns.ts";
import { type Choice, shownPackets } from "./losses.ts";

/** The concealer that draws copies. */
const SKETCH = "sketch";

/** Gaussians to be drawn, part by part. */
export interface Shown {
  readonly parts: readonly Splats[];
  /** Whether they are there instead of those that were drawn before, not in addition. */
  readonly instead: boolean;
  /** Whether some are of packets that were not drawn before. */
  readonly fresh: boolean;
  /** Of how many elements some are drawn now. */
  readonly elements: number;
  /** Number of redundant Gaussians among all that are drawn now: copies for lost elements. */
  readonly copies: number;
}

export class Received {
  readonly decoder: StreamDecoder;
  readonly #parts: Part[] = [];
  /** First element of each part, in order of arrival. */
  readonly #firsts: number[] = [];
  #count = 0;
  /** How many parts are drawn, and the elements of the Gaussians that are; null where they are the same. */
  #drawn = 0;
  #owners: Int32Array[] | null = null;
  /** Copies among the parts, and the first of them. */
  #copies: (Copies & { readonly first: number }) | null = null;
  /** Redundant Gaussians that are drawn. */
  #drawnCopies = 0;
  /** Gains of size and opacity of elements, as far as a concealer said. */
  #gains: Float32Array | null = null;

  constructor(head: Head) {
    this.decoder = new StreamDecoder(head);
  }

  /** Whether there is something that is not drawn yet. */
  get hasNew(): boolean {
    return this.#drawn < this.#parts.length;
  }

  /** Decodes one packet. */
  take(bytes: Uint8Array): void {
    const part = this.decoder.take(bytes);
    if (part) this.#push(part);
  }

  /**
   * Makes ready what a concealer draws in addition to what arrived. Throws where that is damaged, or where all elements
   * are too many for what arrived.
   */
  async prepare({ concealer }: Choice, pause: Pause): Promise<void> {
    if (concealer !== "drop") this.decoder.checkAll();
    if (concealer !== SKETCH || this.#copies || !this.decoder.schema.concealers[concealer]) return;
    const copies = await this.decoder.schema.copies(pause);
    if (!copies || this.#copies) return;
    this.#copies = { ...copies, first: this.#count };
    this.#push(copies.part);
  }

  #push(part: Part): void {
    this.#parts.push(part);
    this.#firsts.push(this.#count);
    this.#count += part.count;
  }

  /** The Gaussians that a camera sees: of all packets, or of those that are not drawn yet. */
  async seen(camera: Camera, all: boolean, pause: Pause): Promise<Shown | null> {
    const { tiling } = this.decoder.schema;
    all = tiling?.look(camera) || all; // other tiles take the place of those that are drawn
    const first = all ? 0 : this.#drawn,
      end = this.#parts.length,
      found: Splats[] = [],
      owners: Int32Array[] = [];
    let copied = all ? 0 : this.#drawnCopies;
    for (let p = first; p < end; p++) {
      if (!(await pause())) return null;
      const part = this.#parts[p],
        seen = part.seen(camera);
      found.push(seen.splats);
      if (part === this.#copies?.part) copied = seen.splats.count;
      if (seen.owners) owners.push(seen.owners.map((owner) => owner + this.#firsts[p]));
    }
    const fresh = this.#drawn < end;
    this.#drawn = end;
    this.#drawnCopies = copied;
    if (this.decoder.schema.viewDependent) this.#owners = all ? owners : [...(this.#owners ?? []), ...owners];
    const reached = this.#firsts[end] ?? this.#count,
      copies = this.#copies;
    return {
      parts: found,
      instead: all,
      fresh,
      elements: reached - (copies && copies.first < reached ? copies.part.count : 0),
      copies: copied,
    };
  }

  /**
   * What takes the place of pieces that are on the screen, each with so many packets, so that they are what a camera is
   * to see: swap by swap, none of which shows a part of the scene twice or not at all. A piece of which more came takes
   * its own place.
   */
  swaps(camera: Camera, held: ReadonlyMap<number, number>): Swap[] {
    const tiling = this.decoder.schema.tiling!;
    tiling.look(camera);
    this.#drawn = this.#parts.length;
    const drawn = new Set(tiling.drawn),
      grown = tiling.drawn.filter((piece) => tiling.packetsOf(piece) > (held.get(piece) ?? Infinity));
    return [
      ...swapsOf(tiling.pieces.parents, new Set(held.keys()), drawn),
      ...grown.map((piece) => ({ gone: [piece], come: [piece] })),
    ];
  }

  /** Gains of the Gaussians of pieces, one piece after another; null where nothing was dropped yet. */
  gainsOfPieces(pieces: readonly number[]): Float32Array | null {
    const gains = this.#gains,
      parts = pieces.flatMap((piece) => this.decoder.schema.tiling!.partsOf(piece));
    if (!gains) return null;
    const firsts = new Map(this.#parts.map((part, p) => [part, this.#firsts[p]])),
      all = new Float32Array(2 * parts.reduce((sum, { which }) => sum + which.length, 0)).fill(1);
    let at = 0;
    for (const { part, which } of parts) {
      const first = firsts.get(part)!;
      for (const n of which) {
        if (2 * (first + n) < gains.length) all.set(gains.subarray(2 * (first + n), 2 * (first + n + 1)), at);
        at += 2;
      }
    }
    return all;
  }

  /** Works out gains of elements, 0 for those of packets that are dropped; how many packets are left. */
  async conceal(choice: Choice, pause: Pause): Promise<number | null> {
    const gains = new Float32Array(2 * this.#count),
      { schema } = this.decoder;
    const came = this.#parts.flatMap((part, p) =>
      part.packet ? [{ part, packet: part.packet, first: this.#firsts[p] }] : [],
    );
    const shown = shownPackets(
        came.map(({ packet }) => packet),
        choice,
      ),
      parts = came.filter((_, p) => shown[p]);
    const there = parts.map(({ part }) => part),
      copies = choice.concealer === SKETCH ? this.#copies : null,
      which = this.#lacking(there);
    const drawn = copies ? [...there, copies.chosen(which)] : there,
      received = drawn.reduce((sum, part) => sum + part.count, 0);
    const found = await (schema.concealers[choice.concealer] ?? schema.concealers["drop"])(
      received,
      () => schema.elements(drawn, pause),
      pause,
    );
    if (!found) return null;
    let at = 0;
    for (const { part, first } of parts) {
      gains.set(found.subarray(2 * at, 2 * (at + part.count)), 2 * first);
      at += part.count;
    }
    if (copies)
      which.forEach((n, i) => gains.set(found.subarray(2 * (at + i), 2 * (at + i + 1)), 2 * (copies.first + n)));
    this.#gains = gains;
    return parts.length;
  }

  /** The copies of what is not in these parts. */
  #lacking(parts: readonly Part[]): Int32Array {
    const there = new Uint8Array(this.decoder.head.manifest.count),
      copied = this.#copies?.part.places ?? new Int32Array();
    for (const { places } of parts) for (const place of places) there[place] = 1;
    return copied.map((_, n) => n).filter((n) => !there[copied[n]]);
  }

  /**
   * Gains of the Gaussians that are drawn, in their order; of elements that came later there are none, they are drawn
   * as they are.
   */
  get gains(): Float32Array | null {
    return this.#gains && this.#gainsOfDrawn(this.#gains);
  }

  /** Gains that hide redundant Gaussians and nothing else, as `gains`; null where there are none to hide. */
  get gainsWithoutCopies(): Float32Array | null {
    const copies = this.#copies;
    if (!copies) return null;
    const gains = new Float32Array(2 * this.#count).fill(1);
    return this.#gainsOfDrawn(gains.fill(0, 2 * copies.first, 2 * (copies.first + copies.part.count)));
  }

  /** From gains of elements to those of the Gaussians that are drawn. */
  #gainsOfDrawn(gains: Float32Array): Float32Array {
    const owners = this.#owners;
    if (!owners) return gains.slice();
    const all = new Float32Array(2 * owners.reduce((sum, part) => sum + part.length, 0)).fill(1);
    let at = 0;
    for (const part of owners) {
      for (const owner of part) {
        if (2 * owner < gains.length) all.set(gains.subarray(2 * owner, 2 * owner + 2), at);
        at += 2;
      }
    }
    return all;
  }
}
