// From a stream's head and packets to Gaussians.

import { BitstreamError, ByteReader } from "../bytes.ts";
import type { Head } from "../packets/container.ts";
import type { Packet } from "../packets/packet.ts";
import { Intake, Plan } from "../packets/plan.ts";
import { symbolsDigest } from "./gaussians/digest.ts";
import { PacketDecoder, type Decoded } from "./gaussians/packet.ts";
import { readSideInfo, type SideInfo } from "./gaussians/side_info.ts";
import { toSplats } from "./gaussians/to_splats.ts";
import type { Splats } from "./splats.ts";

/** Said where a stream holds anchors: their networks are evaluated in Python. */
export const ANCHORS = "This stream carries anchors with neural heads (format 1), which this page cannot draw. " +
  "Use `splatwire view`, or send explicit Gaussians: `splatwire export ply`, then `splatwire encode` and `splatwire serve`.";

/** Where a scene is looked at first, in its own units. */
export interface Viewpoint {
  readonly eye: readonly [number, number, number];
  readonly target: readonly [number, number, number];
  readonly up: readonly [number, number, number];
}

/** Gaussians of one packet, as they were received. */
export interface Part {
  readonly packet: Packet;
  readonly splats: Splats;
}

export class StreamDecoder {
  readonly info: SideInfo;
  readonly intake: Intake;
  readonly #packets: PacketDecoder;

  constructor(readonly head: Head) {
    if (head.manifest.codec !== "gaussians") throw new BitstreamError(ANCHORS);
    const plan = new Plan(head.manifest);
    this.info = readSideInfo(head.sideInfo, plan.numBlocks);
    this.intake = new Intake(plan);
    this.#packets = new PacketDecoder(this.info);
  }

  /** RGB behind the scene. */
  get background(): [number, number, number] {
    const section = this.info.sections.get("background");
    if (!section) return [0, 0, 0];
    const reader = new ByteReader(section, "section 'background'"), color: [number, number, number] = [reader.f32(), reader.f32(), reader.f32()];
    reader.finish();
    if (!color.every((value) => value >= 0 && value <= 1)) throw new BitstreamError("side information: an impossible background");
    return color;
  }

  /** Where the scene is looked at first: eye, the point that it looks at, what is up there; null where nobody said. */
  get viewpoint(): Viewpoint | null {
    const section = this.info.sections.get("viewpoint");
    if (!section) return null;
    const reader = new ByteReader(section, "section 'viewpoint'"), three = (): [number, number, number] => [reader.f32(), reader.f32(), reader.f32()];
    const found = { eye: three(), target: three(), up: three() };
    reader.finish();
    const apart = Math.hypot(...found.eye.map((value, axis) => value - found.target[axis]));
    if (!(apart > 0 && apart < Infinity && Math.hypot(...found.up) > 0.5 && Math.hypot(...found.up) < 2)) {
      throw new BitstreamError("side information: an impossible viewpoint");
    }
    return found;
  }

  /** Gaussians of a packet that is new and fits; null for anything else, which is counted. */
  take(bytes: Uint8Array): Part | null {
    const packet = this.intake.offer(bytes);
    return packet && { packet, splats: toSplats(this.integers(packet), this.info, packet.block) };
  }

  integers(packet: Packet): Decoded {
    return this.#packets.decode(packet.payload, packet.block, packet.count);
  }

  /** The digest of everything, decoded once more; equals the manifest's where nothing was lost. */
  digest(): string {
    const blocks = Array.from({ length: this.intake.plan.numBlocks }, (_, block) => this.intake.blocks.get(block) ?? []);
    return symbolsDigest(blocks.map((packets) => packets.map((packet) => this.integers(packet))));
  }
}
