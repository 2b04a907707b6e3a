// The Gaussians of a transfer in the order in which they came, and which of them are shown where packets are dropped on purpose.

import { StreamDecoder } from "../codec/decoder.ts";
import { expectedElements, type Run } from "../codec/expected.ts";
import { emptySplats, type Splats } from "../codec/splats.ts";
import { CONCEALERS, type Pause } from "../conceal/conceal.ts";
import type { Head } from "../packets/container.ts";

interface Arrived {
  readonly block: number;
  readonly lane: number;
  /** First Gaussian in order of arrival. */
  readonly first: number;
  readonly splats: Splats;
}

export class Received {
  readonly decoder: StreamDecoder;
  readonly #arrived: Arrived[] = [];
  #count = 0;

  constructor(head: Head) {
    this.decoder = new StreamDecoder(head);
  }

  get numPackets(): number {
    return this.#arrived.length;
  }

  /** Decodes one packet. */
  take(bytes: Uint8Array): void {
    const part = this.decoder.take(bytes);
    if (!part) return;
    this.#arrived.push({ block: part.packet.block, lane: part.packet.lane, first: this.#count, splats: part.splats });
    this.#count += part.splats.count;
  }

  /** Copies of the Gaussians of all packets from the n-th on, in one piece. */
  since(packet: number): Splats {
    const parts = this.#arrived.slice(packet), all = emptySplats(parts.reduce((sum, part) => sum + part.splats.count, 0), this.decoder.info.degree);
    const number = this.decoder.info.numHarmonics;
    let at = 0;
    for (const { splats } of parts) {
      all.means.set(splats.means, 3 * at);
      all.quats.set(splats.quats, 4 * at);
      all.scales.set(splats.scales, 3 * at);
      all.opacities.set(splats.opacities, at);
      all.colours.set(splats.colours, 3 * at);
      all.harmonics.set(splats.harmonics, number * at);
      at += splats.count;
    }
    return all;
  }

  /** Gains of size and opacity of each Gaussian in order of arrival, 0 for those of packets that are dropped; and how many packets are left. */
  async gains(concealer: string, dropped: number, seed: number, pause: Pause): Promise<{ gains: Float32Array; shownPackets: number } | null> {
    const shown = this.#arrived.filter((part) => !isDropped(part, dropped, seed)), gains = new Float32Array(2 * this.#count);
    const { plan } = this.decoder.intake, runs = Array.from({ length: plan.numBlocks }, (): Run[] => []), firsts: Arrived[][] = runs.map(() => []);
    for (const part of [...shown].sort((a, b) => a.lane - b.lane)) firsts[part.block].push(part);
    firsts.forEach((parts, block) => {
      const there = parts.reduce((sum, part) => sum + part.splats.count, 0), lost = plan.blockCount(block) - there;
      for (const part of parts) runs[block].push({ splats: part.splats, count: part.splats.count });
      if (lost > 0) runs[block].push({ splats: null, count: lost });
    });
    const found = await (CONCEALERS[concealer] ?? CONCEALERS["drop"])(expectedElements(this.decoder.info, runs), pause);
    if (!found) return null;
    let at = 0;
    runs.forEach((list, block) => {
      firsts[block].forEach((part) => {
        gains.set(found.subarray(2 * at, 2 * (at + part.splats.count)), 2 * part.first);
        at += part.splats.count;
      });
      at += list.reduce((sum, run) => sum + (run.splats ? 0 : run.count), 0);
    });
    return { gains, shownPackets: shown.length };
  }
}

/** Whether a packet is dropped on purpose; more of them with a larger share, and never another one instead. */
function isDropped({ block, lane }: { block: number; lane: number }, share: number, seed: number): boolean {
  let hash = Math.imul(block + 1, 0x9e3779b1) ^ Math.imul(lane + 1, 0x85ebca6b) ^ Math.imul(seed + 1, 0xc2b2ae35);
  hash = Math.imul(hash ^ (hash >>> 15), 0x2c1b3c6d);
  hash = Math.imul(hash ^ (hash >>> 12), 0x297a2d39);
  return ((hash ^ (hash >>> 15)) >>> 0) / 2 ** 32 < share;
}
