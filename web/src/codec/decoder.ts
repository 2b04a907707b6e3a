// Decoder of a stream: head and packets in, elements out.

import { BitstreamError, ByteReader } from "../bytes.ts";
import type { Head } from "../packets/container.ts";
import type { Packet } from "../packets/packet.ts";
import { Intake, type Plan, planOf } from "../packets/plan.ts";
import { ANTIALIASED, BACKGROUND, EXTENT, METADATA, ORIGIN, UP, VIEWPOINT } from "../packets/section_names.ts";
import type { Pause } from "../scheduler.ts";
import { CausalDecoder } from "./causal/causal_decoder.ts";
import type { ElementBatch } from "./element_batch.ts";
import type { ElementDecoder } from "./element_decoder.ts";
import type { Verification } from "./gaussians/digest.ts";
import { GaussianDecoder } from "./gaussians/gaussian_decoder.ts";
import { countLanesFast } from "./gaussians/native.ts";
import { LevelDecoder } from "./levels/level_decoder.ts";
import { checkMemory } from "./memory.ts";
import { type Texts, textsOf } from "./metadata.ts";
import { TrackDecoder } from "./tracks/track_decoder.ts";

/** Error message for anchors of format 1. */
export const FORMAT_1_MESSAGE =
  "This stream has format 1 (anchors of HAC++), which browsers cannot decode: use `splatwire view`, " +
  "train with --model causal, or send explicit Gaussians (`splatwire export ply`, then `splatwire encode`).";

/** View of a camera, world units: initial view of a scene, or the current one. */
export interface Viewpoint {
  readonly eye: readonly [number, number, number];
  readonly target: readonly [number, number, number];
  readonly up: readonly [number, number, number];
}

/** Sphere, world units. */
export interface BoundingSphere {
  readonly middle: readonly number[];
  readonly radius: number;
}

function elementDecoderOf(
  { manifest, sideInfo }: Head,
  plan: Plan,
  verify: Verification,
  updates: boolean,
): ElementDecoder {
  const { order, packaging } = manifest.packetization;
  if (manifest.codec !== "hacpp" && packaging !== "atomic")
    throw new BitstreamError("the stream's packets do not hold whole elements");
  if (manifest.codec === "causal" && order !== "morton")
    throw new BitstreamError("anchors of the causal model must be in Morton order, but the manifest has another one");
  if (manifest.codec === "gaussians" || (updates && manifest.codec === "update"))
    return new GaussianDecoder(sideInfo, plan, verify);
  if (manifest.codec === "levels") return new LevelDecoder(sideInfo, plan);
  if (manifest.codec === "causal") return new CausalDecoder(sideInfo, plan);
  if (manifest.codec === "tracks") return new TrackDecoder(sideInfo, plan);
  if (manifest.codec === "update")
    throw new BitstreamError(
      "the stream is an update: `splatwire apply` makes the changed stream of it and the old one",
    );
  throw new BitstreamError(FORMAT_1_MESSAGE);
}

export class StreamDecoder {
  readonly elementDecoder: ElementDecoder;
  readonly intake: Intake;
  /** Number of received bytes, and the memory of their elements in bytes. */
  #numBytes: number;
  #needed = 0;

  /** `updates` also accepts updates, and decodes their new Gaussians. */
  constructor(
    public head: Head,
    verify: Verification = null,
    updates = false,
  ) {
    const plan = planOf(head.manifest, countLanesFast);
    this.elementDecoder = elementDecoderOf(head, plan, verify, updates);
    this.intake = new Intake(plan);
    this.#numBytes = head.sideInfo.length;
    this.#checkView();
  }

  /** Continues with a longer head of the same stream. Throws `BitstreamError` if it contradicts the earlier one. */
  grow(head: Head): void {
    const { tiers } = this.head.manifest,
      longer = head.manifest.tiers;
    const same = tiers.every(({ count, lanes }, n) => longer[n]?.count === count && longer[n].lanes === lanes);
    if (!this.elementDecoder.grow || !same)
      throw new BitstreamError("the stream's new head contradicts its earlier one");
    const plan = planOf(head.manifest, countLanesFast);
    this.elementDecoder.grow(head.sideInfo, plan);
    this.intake.plan = plan;
    this.head = head;
  }

  /** Checks the sections that define the initial view, as the Python decoder does, before anything is drawn. */
  #checkView(): void {
    // calls, because minification drops unused getters
    for (const name of ["background", "viewpoint", "extent", "up", "origin"] as const) Reflect.get(this, name);
  }

  /** Background colour, RGB, each 0 to 1. */
  get background(): [number, number, number] {
    const section = this.elementDecoder.sections.get(BACKGROUND);
    if (!section) return [0, 0, 0];
    const reader = new ByteReader(section, "section 'background'"),
      color: [number, number, number] = [reader.f32(), reader.f32(), reader.f32()];
    reader.finish();
    if (!color.every((value) => value >= 0 && value <= 1))
      throw new BitstreamError("section 'background': a colour is not between 0 and 1");
    return color;
  }

  /** Initial view; null if the stream has none. */
  get viewpoint(): Viewpoint | null {
    const section = this.elementDecoder.sections.get(VIEWPOINT);
    if (!section) return null;
    const reader = new ByteReader(section, "section 'viewpoint'"),
      three = (): [number, number, number] => [reader.f32(), reader.f32(), reader.f32()];
    const found = { eye: three(), target: three(), up: three() };
    reader.finish();
    const distance = Math.hypot(...found.eye.map((value, axis) => value - found.target[axis]));
    if (!(distance > 0 && distance < Infinity && Math.hypot(...found.up) > 0.5 && Math.hypot(...found.up) < 2)) {
      throw new BitstreamError("section 'viewpoint': the eye or the up direction is out of range");
    }
    return found;
  }

  /** Sphere around nearly all Gaussians of every frame of a clip, world units; null if the stream has none. */
  get extent(): BoundingSphere | null {
    const section = this.elementDecoder.sections.get(EXTENT);
    if (!section) return null;
    const reader = new ByteReader(section, "section 'extent'"),
      [x, y, z, radius] = [reader.f32(), reader.f32(), reader.f32(), reader.f32()];
    reader.finish();
    if (![x, y, z].every(Number.isFinite) || !(radius > 0 && radius < Infinity))
      throw new BitstreamError("section 'extent': the sphere is not finite or has no radius");
    return { middle: [x, y, z], radius };
  }

  /**
   * World coordinates of the point that all positions are relative to. It is 0, 0, 0 unless the scene is georeferenced.
   */
  get origin(): [number, number, number] {
    const section = this.elementDecoder.sections.get(ORIGIN);
    if (!section) return [0, 0, 0];
    const reader = new ByteReader(section, "section 'origin'"),
      origin: [number, number, number] = [reader.f64(), reader.f64(), reader.f64()];
    reader.finish();
    if (!origin.every((value) => Math.abs(value) <= 1e12))
      throw new BitstreamError("section 'origin': a coordinate is not between -1e12 and 1e12");
    return origin;
  }

  /** Title, author and license of the scene; each is empty if the stream does not have it. */
  get texts(): Texts {
    return textsOf(this.elementDecoder.sections.get(METADATA));
  }

  /** True if opacity decreases for Gaussians below the size of a pixel (Mip-Splatting). */
  get antialiased(): boolean {
    return this.elementDecoder.sections.has(ANTIALIASED);
  }

  /** Up axis of the scene: `x`, `-x`, `y`, `-y`, `z` or `-z`; null if the stream has none. */
  get up(): string | null {
    const section = this.elementDecoder.sections.get(UP),
      up = section && new TextDecoder("utf-8", { ignoreBOM: true }).decode(section);
    if (up !== undefined && !/^-?[xyz]$/.test(up))
      throw new BitstreamError("section 'up': not one of x, -x, y, -y, z, -z");
    return up ?? null;
  }

  /**
   * Adds a packet, and decodes it unless such packets are decoded only for drawing, like those with motion. Returns
   * null, and counts it, if it is invalid or a duplicate. Throws `BitstreamError` if the decoded elements need too much
   * memory for the received bytes.
   */
  addPacket(bytes: Uint8Array): ElementBatch | null {
    const packet = this.admit(bytes);
    return packet && this.elementDecoder.read(packet);
  }

  /**
   * Checks a packet, like `addPacket`, and returns it. The caller has it decoded and passes it to
   * `elementDecoder.accept`.
   */
  admit(bytes: Uint8Array): Packet | null {
    const packet = this.intake.offer(bytes);
    if (!packet) return null;
    this.#numBytes += bytes.length;
    this.#needed += this.elementDecoder.bytesOf(packet);
    this.#check(this.#needed, "decoding the received packets");
    return packet;
  }

  /** Throws `BitstreamError` if concealment, which needs all elements including lost ones, takes too much memory. */
  checkConcealmentMemory(): void {
    const { count } = this.head.manifest;
    this.#check(count * this.elementDecoder.concealmentBytes, `concealing ${count} elements`);
  }

  #check(needed: number, activity: string): void {
    checkMemory(needed, this.#numBytes, activity);
  }

  /**
   * Returns the digest of all decoded integers. It equals that of the manifest if no packet is missing. Packets are
   * decoded again unless `verify` was set.
   */
  digest(pause: Pause = async () => true): Promise<string> {
    return this.elementDecoder.digest(
      Array.from({ length: this.intake.plan.numBlocks }, (_, block) => this.intake.blocks.get(block) ?? []),
      pause,
    );
  }
}
