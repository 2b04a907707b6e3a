// From a stream's head and packets to elements.

import { BitstreamError, ByteReader } from "../bytes.ts";
import type { Head } from "../packets/container.ts";
import { Intake, Plan } from "../packets/plan.ts";
import type { Pause } from "../turns.ts";
import { CausalSchema } from "./causal/schema.ts";
import { ColumnsSchema } from "./columns/schema.ts";
import { GaussianSchema } from "./gaussians/schema.ts";
import { LevelSchema } from "./levels/schema.ts";
import { checkMemory } from "./memory.ts";
import type { Part } from "./part.ts";
import type { Schema } from "./schema.ts";
import { TrackSchema } from "./tracks/schema.ts";

/** Said where a stream holds anchors of format 1. */
export const FORMAT_1 =
  "This stream has format 1 (anchors of HAC++), which this page cannot draw: use `splatwire view`, " +
  "train with --model causal, or send explicit Gaussians (`splatwire export ply`, then `splatwire encode`).";

/** Where a scene is looked at first, in its own units. */
export interface Viewpoint {
  readonly eye: readonly [number, number, number];
  readonly target: readonly [number, number, number];
  readonly up: readonly [number, number, number];
}

/** A ball, world units. */
export interface Ball {
  readonly middle: readonly number[];
  readonly radius: number;
}

function schemaOf({ manifest, sideInfo }: Head, plan: Plan): Schema {
  const { order, packaging } = manifest.packetization;
  if (manifest.codec !== "hacpp" && packaging !== "atomic")
    throw new BitstreamError("the stream's packets do not hold whole elements");
  if (manifest.codec === "causal" && order !== "morton")
    throw new BitstreamError("anchors of the causal model are in Morton order, and the manifest says otherwise");
  if (manifest.codec === "gaussians") return new GaussianSchema(sideInfo, plan);
  if (manifest.codec === "levels") return new LevelSchema(sideInfo, plan);
  if (manifest.codec === "causal") return new CausalSchema(sideInfo, plan);
  if (manifest.codec === "tracks") return new TrackSchema(sideInfo, plan);
  if (manifest.codec === "columns") return new ColumnsSchema(sideInfo, plan);
  throw new BitstreamError(FORMAT_1);
}

export class StreamDecoder {
  readonly schema: Schema;
  readonly intake: Intake;
  /** Bytes that arrived, and of memory what their elements take. */
  #numBytes: number;
  #needed = 0;

  constructor(public head: Head) {
    const plan = new Plan(head.manifest);
    this.schema = schemaOf(head, plan);
    this.intake = new Intake(plan);
    this.#numBytes = head.sideInfo.length;
    this.#checkView();
  }

  /** Goes on with the head of the same stream that has grown. Throws where it says other things of what was there. */
  grow(head: Head): void {
    const { tiers } = this.head.manifest,
      longer = head.manifest.tiers;
    const same = tiers.every(({ count, lanes }, n) => longer[n]?.count === count && longer[n].lanes === lanes);
    if (!this.schema.grow || !same)
      throw new BitstreamError("a stream that grows says other things of what was there already");
    const plan = new Plan(head.manifest);
    this.schema.grow(head.sideInfo, plan);
    this.intake.plan = plan;
    this.head = head;
  }

  /** Refuses what no view can begin with, as Python does, before anything is shown. */
  #checkView(): void {
    void this.background;
    void this.viewpoint;
    void this.extent;
    void this.up;
    void this.origin;
  }

  /** RGB behind the scene. */
  get background(): [number, number, number] {
    const section = this.schema.sections.get("background");
    if (!section) return [0, 0, 0];
    const reader = new ByteReader(section, "section 'background'"),
      color: [number, number, number] = [reader.f32(), reader.f32(), reader.f32()];
    reader.finish();
    if (!color.every((value) => value >= 0 && value <= 1))
      throw new BitstreamError("side information: an impossible background");
    return color;
  }

  /** Where the scene is looked at first: eye, the point that it looks at, what is up there; null where nobody said. */
  get viewpoint(): Viewpoint | null {
    const section = this.schema.sections.get("viewpoint");
    if (!section) return null;
    const reader = new ByteReader(section, "section 'viewpoint'"),
      three = (): [number, number, number] => [reader.f32(), reader.f32(), reader.f32()];
    const found = { eye: three(), target: three(), up: three() };
    reader.finish();
    const apart = Math.hypot(...found.eye.map((value, axis) => value - found.target[axis]));
    if (!(apart > 0 && apart < Infinity && Math.hypot(...found.up) > 0.5 && Math.hypot(...found.up) < 2)) {
      throw new BitstreamError("side information: an impossible viewpoint");
    }
    return found;
  }

  /** Where a clip goes: a ball around nearly all of each frame, world units; null where nobody said. */
  get extent(): Ball | null {
    const section = this.schema.sections.get("extent");
    if (!section) return null;
    const reader = new ByteReader(section, "section 'extent'"),
      [x, y, z, radius] = [reader.f32(), reader.f32(), reader.f32(), reader.f32()];
    reader.finish();
    if (![x, y, z].every(Number.isFinite) || !(radius > 0 && radius < Infinity))
      throw new BitstreamError("side information: an impossible extent");
    return { middle: [x, y, z], radius };
  }

  /** World coordinates that all positions are relative to, of geo-referenced scenes; else 0, 0, 0. */
  get origin(): [number, number, number] {
    const section = this.schema.sections.get("origin");
    if (!section) return [0, 0, 0];
    const reader = new ByteReader(section, "section 'origin'"),
      origin: [number, number, number] = [reader.f64(), reader.f64(), reader.f64()];
    reader.finish();
    if (!origin.every((value) => Math.abs(value) <= 1e12))
      throw new BitstreamError("side information: an impossible origin");
    return origin;
  }

  /** Whether Gaussians lose opacity as they are widened to a pixel. */
  get antialiased(): boolean {
    return this.schema.sections.has("antialiased");
  }

  /** Which axis is up: `y`, `-z`, ...; null where nobody said. */
  get up(): string | null {
    const section = this.schema.sections.get("up"),
      up = section && new TextDecoder("utf-8", { ignoreBOM: true }).decode(section);
    if (up !== undefined && !/^-?[xyz]$/.test(up))
      throw new BitstreamError("side information: an impossible direction that is up");
    return up ?? null;
  }

  /**
   * Elements of a packet that is new and fits; null for anything else, which is counted. Throws where so many elements
   * in so few bytes take too much memory.
   */
  take(bytes: Uint8Array): Part | null {
    const packet = this.intake.offer(bytes);
    if (!packet) return null;
    this.#numBytes += bytes.length;
    this.#needed += this.schema.bytesOf(packet);
    this.#check(this.#needed, "what arrived");
    return this.schema.read(packet);
  }

  /** Throws where looking at all elements, lost ones, too, takes more memory than what arrived may. */
  checkAll(): void {
    const { count } = this.head.manifest;
    this.#check(count * this.schema.lookedAtBytes, `looking at ${count} elements`);
  }

  #check(needed: number, what: string): void {
    checkMemory(needed, this.#numBytes, what);
  }

  /** The digest of everything, decoded once more; equals the manifest's where nothing was lost. */
  digest(pause: Pause = async () => true): Promise<string> {
    return this.schema.digest(
      Array.from({ length: this.intake.plan.numBlocks }, (_, block) => this.intake.blocks.get(block) ?? []),
      pause,
    );
  }
}
