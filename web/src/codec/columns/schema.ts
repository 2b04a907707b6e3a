// Anchors that the server on this machine decoded, because the page does not (format 1): `splatwire view`.

import { ANCHOR_CONCEALERS, type Concealer, grown } from "../../conceal/conceal.ts";
import type { AnchorFacts, Elements } from "../../conceal/elements.ts";
import { grow } from "../../conceal/grow.ts";
import { sceneFreeAnchors } from "../../conceal/scene_free_anchors.ts";
import { Heads } from "../../model/heads.ts";
import type { Packet } from "../../packets/packet.ts";
import type { Plan } from "../../packets/plan.ts";
import type { Pause } from "../../turns.ts";
import { AnchorPart, chosen, givenFirst } from "../anchor_part.ts";
import { LOOKED_AT_BYTES } from "../memory.ts";
import type { Copies } from "../part.ts";
import type { Schema } from "../schema.ts";
import { type TierFacts, tierFacts } from "../tiers.ts";
import { type Rows, readRows, readSideInfo, type SideInfo } from "./side_info.ts";

class ColumnPart extends AnchorPart {
  constructor(
    packet: Packet | null,
    ranks: Int32Array,
    readonly rows: Rows,
    heads: Heads,
  ) {
    super(packet, ranks, rows, heads);
  }
}

export class ColumnsSchema implements Schema<ColumnPart> {
  readonly lookedAtBytes = LOOKED_AT_BYTES;
  readonly tiling = null;
  readonly viewDependent = true;
  readonly moving = null;
  readonly degree = 0;
  readonly #info: SideInfo;
  readonly #heads: Heads;
  readonly #tiers: TierFacts;

  constructor(
    sideInfo: Uint8Array,
    readonly plan: Plan,
  ) {
    this.#info = readSideInfo(sideInfo, plan.manifest.count);
    this.#tiers = tierFacts(this.#info.sections, plan.manifest);
    const [opacity, covariance, color] = this.#info.heads;
    this.#heads = new Heads(opacity, covariance, color);
  }

  get size(): number {
    return this.#info.size;
  }

  get middle(): number[] {
    return this.#info.middle;
  }

  get sections(): Map<string, Uint8Array> {
    return this.#info.sections;
  }

  get concealers(): Readonly<Record<string, Concealer>> {
    const { copies } = this.#info;
    if (!copies) return ANCHOR_CONCEALERS;
    const { rule, trust } = copies;
    return {
      ...ANCHOR_CONCEALERS,
      sketch: grown((all, pause) => (trust ? sceneFreeAnchors(all, pause, rule, trust) : grow(all, pause, rule))),
    };
  }

  bytesOf(packet: Packet): number {
    return packet.count * this.#heads.anchorBytes(this.#info.offsets);
  }

  read(packet: Packet): ColumnPart {
    const places = this.plan.members(packet),
      { order } = this.#tiers,
      ranks = order ? places.map((place) => order[place]) : places;
    return new ColumnPart(packet, ranks, readRows(packet.payload, this.#positions(ranks), this.#info), this.#heads);
  }

  /** The server that decoded them has compared their integers with the manifest's digest; there are none here. */
  async digest(): Promise<string> {
    return this.plan.manifest.symbolsDigest;
  }

  async copies(): Promise<Copies<ColumnPart> | null> {
    const { ranks, rows } = this.#info.copies!;
    const part = (which: Int32Array): ColumnPart => {
      const logScales = Float32Array.from(which, (n) => rows.logScales[n]);
      return new ColumnPart(
        null,
        which.map((n) => ranks[n]),
        { ...chosen(rows, which), logScales },
        this.#heads,
      );
    };
    return { part: part(ranks.map((_, n) => n)), chosen: part };
  }

  async elements(parts: readonly ColumnPart[], pause: Pause): Promise<Elements | null> {
    if (!(await pause())) return null;
    const { count } = this.plan.manifest,
      { known } = this.#info,
      { ranks, end } = givenFirst(parts, count),
      { sizes } = this.#tiers;
    let facts: AnchorFacts | null = null;
    return {
      positions: this.#positions(ranks),
      sizes: Float32Array.from(ranks, (rank) => known[6 * rank + 3]),
      tierSizes: sizes && Float32Array.from(ranks, (rank) => sizes[rank]),
      opacities: null,
      known: new Uint8Array(count).fill(1, 0, end),
      places: ranks,
      logScales: null,
      anchors: () => (facts ??= this.#facts(parts, ranks.subarray(0, end))),
    };
  }

  #facts(parts: readonly ColumnPart[], ranks: Int32Array): AnchorFacts {
    const logs = new Float64Array(4 * ranks.length),
      active = new Uint8Array(ranks.length),
      { known } = this.#info;
    let at = 0;
    for (const {
      rows: {
        anchors: { count, numOffsets, sizes, masks },
        logScales,
      },
    } of parts) {
      for (let n = 0; n < count; n++, at++) {
        logs[4 * at] = logScales[n];
        for (let a = 0; a < 3; a++) logs[4 * at + 1 + a] = Math.log(sizes[3 * n + a]);
        for (let k = n * numOffsets; k < (n + 1) * numOffsets; k++) active[at] += masks[k];
      }
    }
    const unsure = Float64Array.from({ length: 2 * ranks.length }, (_, n) => known[6 * ranks[n >> 1] + 4 + (n & 1)]);
    return { logs, active, unsure };
  }

  #positions(ranks: Int32Array): Float32Array {
    const { known } = this.#info;
    return Float32Array.from({ length: 3 * ranks.length }, (_, n) => known[6 * ranks[Math.floor(n / 3)] + (n % 3)]);
  }
}
