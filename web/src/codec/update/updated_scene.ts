// A scene of explicit Gaussians that updates change. Drawn Gaussians keep their index: removed ones are only hidden,
// new ones are appended.

import { BitstreamError } from "../../bytes.ts";
import type { SideInfo } from "../gaussians/side_info.ts";
import { type Splats, selectSplats } from "../splats.ts";
import { readRemoved, type SceneUpdate } from "./update.ts";

/** Bits of a coordinate in a Morton code, and those of its low part. The halves of a code are exact as doubles. */
const AXIS_BITS = 21,
  LOW_BITS = 11,
  LOW = 2 ** LOW_BITS;
/** Numbers below 2^11 with two zeros between their bits. */
const SPREAD = Float64Array.from({ length: LOW }, (_, value) => {
  let spread = 0;
  for (let bit = 0; bit < LOW_BITS; bit++) if ((value >> bit) & 1) spread += 8 ** bit;
  return spread;
});

/** Change of the drawn Gaussians: indices of those to hide, ascending, and new ones to append. */
export interface SceneChange {
  readonly hidden: Int32Array;
  readonly splats: readonly Splats[];
}

export class UpdatedScene {
  #parts: Splats[] = [];
  /** Index of the first Gaussian of each part. */
  #firsts: number[] = [];
  /** Number of drawn Gaussians, hidden ones included, and the indices of those that are not hidden, ascending. */
  #drawn = 0;
  #visible = new Int32Array();
  /** Index of each drawn Gaussian in the scene before all updates, -1 for new ones. */
  #sources = new Int32Array();
  #changed = false;

  /**
   * `digest` is the SHA-256 of the scene's manifest, hexadecimal. `header` is the header of the side information, and
   * `parts` are the Gaussians in drawing order.
   */
  constructor(
    public digest: string,
    readonly info: SideInfo,
    readonly header: string,
    parts: readonly Splats[],
  ) {
    this.#append(parts);
    this.#sources = this.#sources.map((_, n) => n);
  }

  /** Number of Gaussians of the scene. */
  get count(): number {
    return this.#visible.length;
  }

  /** True after the first update. */
  get changed(): boolean {
    return this.#changed;
  }

  /** Number of hidden Gaussians. */
  get numHidden(): number {
    return this.#drawn - this.#visible.length;
  }

  /**
   * Applies an update. Throws `BitstreamError`, and changes nothing, if the update is for another scene or damaged.
   */
  apply(update: SceneUpdate): SceneChange {
    if (update.baseDigest !== this.digest) throw new BitstreamError("the update changes another scene");
    if (update.header !== this.header) throw new BitstreamError("the update has other quantisation steps");
    const mask = readRemoved(update.removed, this.count),
      order = this.#curveOrder(),
      removed = new Uint8Array(this.#drawn);
    for (let n = 0; n < mask.length; n++) if (mask[n]) removed[this.#visible[order[n]]] = 1;
    const hidden = this.#visible.filter((n) => removed[n]);
    if (hidden.length === this.count && !update.splats.length)
      throw new BitstreamError("the update removes all Gaussians");
    this.#visible = this.#visible.filter((n) => !removed[n]);
    this.#append(update.splats);
    this.digest = update.resultDigest;
    this.#changed = true;
    return { hidden, splats: update.splats };
  }

  /** Forgets the hidden Gaussians. Returns the others, which replace all drawn ones. */
  compact(): readonly Splats[] {
    const parts = this.visibleParts().filter(({ count }) => count),
      sources = this.#visible.map((n) => this.#sources[n]);
    this.#parts = [];
    this.#firsts = [];
    this.#drawn = 0;
    this.#visible = this.#sources = new Int32Array();
    this.#append(parts);
    this.#sources = sources;
    return parts;
  }

  /**
   * Returns gains of size and opacity of the drawn Gaussians, from those of the scene before all updates. New Gaussians
   * have gain 1.
   */
  gainsOfDrawn(before: Float32Array): Float32Array {
    const gains = new Float32Array(2 * this.#drawn).fill(1);
    this.#sources.forEach((from, n) => from < 0 || gains.set(before.subarray(2 * from, 2 * from + 2), 2 * n));
    return gains;
  }

  /** Returns the Gaussians that are not hidden, part by part. */
  visibleParts(): Splats[] {
    let at = 0;
    return this.#parts.map((part, p) => {
      const first = at;
      while (at < this.count && this.#visible[at] < this.#firsts[p] + part.count) at++;
      return selectSplats(
        part,
        this.#visible.subarray(first, at).map((n) => n - this.#firsts[p]),
      );
    });
  }

  #append(parts: readonly Splats[]): void {
    const before = this.#drawn,
      kept = this.#visible,
      sources = this.#sources;
    for (const part of parts) {
      this.#parts.push(part);
      this.#firsts.push(this.#drawn);
      this.#drawn += part.count;
    }
    this.#sources = new Int32Array(this.#drawn).fill(-1);
    this.#sources.set(sources);
    this.#visible = new Int32Array(kept.length + this.#drawn - before);
    this.#visible.set(kept);
    for (let n = before; n < this.#drawn; n++) this.#visible[kept.length + n - before] = n;
  }

  /**
   * Sorts the visible Gaussians along a Morton curve, those in one cell by their attributes. Counterpart of
   * `splatwire.codec.update.removed.curve_order`.
   */
  #curveOrder(): Int32Array {
    const { count } = this,
      coords = this.#coords(),
      least = [Infinity, Infinity, Infinity];
    for (let i = 0; i < coords.length; i++) least[i % 3] = Math.min(least[i % 3], coords[i]);
    let most = 0,
      shift = 0;
    for (let i = 0; i < coords.length; i++) most = Math.max(most, (coords[i] -= least[i % 3]));
    while (most >= 2 ** (AXIS_BITS + shift)) shift++;
    const high = new Float64Array(count),
      low = new Float64Array(count);
    for (let n = 0; n < count; n++)
      for (let axis = 0; axis < 3; axis++) {
        const coord = Math.floor(coords[3 * n + axis] / 2 ** shift);
        high[n] += SPREAD[coord >> LOW_BITS] * 2 ** axis;
        low[n] += SPREAD[coord & (LOW - 1)] * 2 ** axis;
      }
    return Int32Array.from({ length: count }, (_, n) => n).sort(
      (a, b) => high[a] - high[b] || low[a] - low[b] || this.#compare(this.#visible[a], this.#visible[b]),
    );
  }

  /** Returns the lattice coordinates of the visible Gaussians, shape (count, 3). */
  #coords(): Float64Array {
    const { latticeBits, sizeLog } = this.info,
      scale = 2 ** (latticeBits - sizeLog),
      coords = new Float64Array(3 * this.count);
    let part = 0;
    this.#visible.forEach((n, to) => {
      while (n >= this.#firsts[part] + this.#parts[part].count) part++;
      const { means } = this.#parts[part],
        from = 3 * (n - this.#firsts[part]);
      for (let axis = 0; axis < 3; axis++) coords[3 * to + axis] = Math.floor(means[from + axis] * scale);
    });
    return coords;
  }

  /** Compares the attributes of two Gaussians in the order of the format. */
  #compare(a: number, b: number): number {
    const [one, i] = this.#find(a),
      [other, j] = this.#find(b);
    for (const name of ["means", "opacities", "scales", "quats", "colours", "harmonics"] as const) {
      const width = one.count ? one[name].length / one.count : 0;
      for (let k = 0; k < width; k++) {
        const difference = one[name][width * i + k] - other[name][width * j + k];
        if (difference) return difference;
      }
    }
    return 0;
  }

  /** Returns the part of a drawn Gaussian, and its index in the part. */
  #find(n: number): [Splats, number] {
    let low = 0,
      high = this.#firsts.length;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (this.#firsts[middle] <= n) low = middle;
      else high = middle;
    }
    return [this.#parts[low], n - this.#firsts[low]];
  }
}
