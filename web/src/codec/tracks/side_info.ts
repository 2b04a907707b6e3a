// Side information of a clip.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { MAX_FRAME_RATE, MAX_FRAMES, MAX_GROUP_FRAMES } from "../../packets/limits.ts";
import type { Manifest } from "../../packets/manifest.ts";
import { readSections } from "../../packets/sections.ts";
import { readSideInfo, type SideInfo } from "../gaussians/side_info.ts";
import { NUM_CONTEXTS, NUM_KINDS } from "./layout.ts";
import { type Lifetimes, readLifetimes } from "./lifetimes.ts";
import type { Group, Timeline } from "./timeline.ts";

const VERSION = 1,
  MAX_OFFSET = 16;

export interface SequenceInfo {
  readonly timeline: Timeline;
  readonly groups: readonly Group[];
  readonly numTracks: number;
  readonly bases: SideInfo;
  /** Ratio of motion steps to those of the base in octaves, per kind of channel. */
  readonly coarser: readonly number[];
  /** Initial state of the adaptive models of each motion packet, two estimates per context. */
  readonly models: Int32Array;
  readonly sections: Map<string, Uint8Array>;
  readonly lifetimes: Lifetimes;
}

export function readSequenceInfo(bytes: Uint8Array, manifest: Manifest): SequenceInfo {
  if (manifest.packetization.grouping !== "hashed")
    throw new BitstreamError("a clip needs hashed grouping, but the manifest has another one");
  const reader = new ByteReader(bytes, "side information"),
    clip = reader.blob(),
    bases = reader.blob(),
    motion = reader.blob(),
    timeline = readTimeline(clip),
    groups = groupsOf(manifest),
    numGroups = Math.ceil(timeline.numFrames / timeline.groupFrames);
  if (groups.length !== numGroups)
    throw new BitstreamError(`side information: ${numGroups} groups of frames, the manifest has ${groups.length}`);
  const size = manifest.packetization.blockSize,
    blocks = groups.reduce((sum, group) => sum + Math.ceil(group.births / size), 0),
    numTracks = groups.reduce((sum, group) => sum + group.births, 0);
  const steps = readMotion(motion),
    sections = readSections(reader.rest());
  return {
    timeline,
    groups,
    numTracks,
    ...steps,
    sections,
    lifetimes: readLifetimes(sections, groups, timeline),
    bases: readSideInfo(bases, blocks),
  };
}

function readTimeline(bytes: Uint8Array): Timeline {
  const reader = new ByteReader(bytes, "side information of the clip"),
    version = reader.u8();
  if (version !== VERSION)
    throw new BitstreamError(`side information has version ${version}, this version reads ${VERSION}`);
  const numerator = reader.unsigned(),
    denominator = reader.unsigned(),
    numFrames = reader.unsigned(),
    groupFrames = reader.unsigned();
  const possible =
    denominator > 0 && denominator <= MAX_FRAMES && numerator > 0 && numerator <= MAX_FRAME_RATE * denominator;
  if (!(possible && numFrames > 0 && numFrames <= MAX_FRAMES && groupFrames > 0 && groupFrames <= MAX_GROUP_FRAMES))
    throw new BitstreamError("side information: the frame rate or the number of frames is out of range");
  reader.finish();
  return { rate: numerator / denominator, numFrames, groupFrames };
}

function groupsOf({ tiers }: Manifest): Group[] {
  const groups: Group[] = [];
  let firstNew = 0;
  for (let tier = 0; tier < tiers.length; tier += 2) {
    const births = tiers[tier].count,
      motions = tiers[tier + 1].count;
    if (motions > firstNew + births)
      throw new BitstreamError(`${motions} tracks move in a group, but only ${firstNew + births} exist`);
    groups.push({ births, motions, firstNew });
    firstNew += births;
  }
  return groups;
}

function readMotion(bytes: Uint8Array): Pick<SequenceInfo, "coarser" | "models"> {
  const reader = new ByteReader(bytes, "side information of motion"),
    coarser = Array.from({ length: NUM_KINDS }, () => reader.signed());
  if (coarser.some((octaves) => Math.abs(octaves) > MAX_OFFSET))
    throw new BitstreamError("side information: a step of motion is out of range");
  const zero = reader.take(NUM_CONTEXTS);
  reader.finish();
  const models = Int32Array.from(
    { length: 2 * NUM_CONTEXTS },
    (_, i) => Math.min(Math.max(zero[i >> 1], 1), 255) * 256,
  );
  return { coarser, models };
}
