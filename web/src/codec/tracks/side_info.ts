// Side information of a clip.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { MAX_FRAME_RATE, MAX_FRAMES, MAX_GROUP_FRAMES } from "../../packets/limits.ts";
import type { Manifest } from "../../packets/manifest.ts";
import { readSections } from "../../packets/sections.ts";
import { readSideInfo, type SideInfo } from "../gaussians/side_info.ts";
import { MAX_LOG2_RATIO, NUM_CONTEXTS, NUM_KINDS } from "./layout.ts";
import { type Lifetimes, readLifetimes } from "./lifetimes.ts";
import type { GroupCounts, Timeline } from "./timeline.ts";

/** Versions: with one shot; and with a unit of motion for each of several shots. */
const VERSION = 1,
  WITH_MOTION_UNITS = 3;
/** Largest ratio of a motion step to that of the keyframe Gaussian, octaves in either direction. */
const MAX_LOG_STEP_RATIO = 16;

/** Consecutive groups with the same lattice, steps and tables for their keyframe Gaussians. */
export interface Shot {
  /** First of the shot's blocks among all blocks of keyframe Gaussians. */
  readonly firstBlock: number;
  readonly firstGroup: number;
  readonly keyframeInfo: SideInfo;
  /** log2 of half the lattice spacing, in units of motion. */
  readonly latticeShift: number;
}

export interface SequenceInfo {
  readonly timeline: Timeline;
  readonly groups: readonly GroupCounts[];
  readonly numTracks: number;
  readonly shots: readonly Shot[];
  /** log2 of the unit of motion in each group of frames, in half lattice units of the first shot. */
  readonly log2MotionUnits: Int8Array;
  /** Side information of the keyframe Gaussians of the first shot. */
  readonly keyframeInfo: SideInfo;
  /** Ratio of motion steps to those of the keyframe Gaussian in octaves, per kind of channel. */
  readonly logStepRatios: readonly number[];
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
    keyframes = reader.blob(),
    motion = reader.blob(),
    { version, timeline } = readTimeline(clip),
    groups = groupsOf(manifest),
    numGroups = Math.ceil(timeline.numFrames / timeline.groupFrames);
  if (groups.length !== numGroups)
    throw new BitstreamError(`side information: ${numGroups} groups of frames, the manifest has ${groups.length}`);
  const size = manifest.packetization.blockSize,
    log2MotionUnits = new Int8Array(numGroups),
    shots = readShots(keyframes, version, groups, size, log2MotionUnits),
    numTracks = groups.reduce((sum, group) => sum + group.numBirths, 0);
  const steps = readMotion(motion),
    sections = readSections(reader.rest());
  return {
    timeline,
    groups,
    numTracks,
    ...steps,
    sections,
    lifetimes: readLifetimes(sections, groups, timeline),
    shots,
    log2MotionUnits,
    keyframeInfo: shots[0].keyframeInfo,
  };
}

/** Returns the shot of a block of keyframe Gaussians, counted among all such blocks. */
export function shotOf({ shots }: SequenceInfo, block: number): Shot {
  let at = 0;
  for (let end = shots.length; end - at > 1; ) {
    const middle = (at + end) >> 1;
    if (shots[middle].firstBlock <= block) at = middle;
    else end = middle;
  }
  return shots[at];
}

/** Reads the shots. Writes log2 of the unit of motion in each group to `log2MotionUnits`. */
function readShots(
  bytes: Uint8Array,
  version: number,
  groups: readonly GroupCounts[],
  size: number,
  log2MotionUnits: Int8Array,
): Shot[] {
  const blocks = [0];
  for (const { numBirths } of groups) blocks.push(blocks[blocks.length - 1] + Math.ceil(numBirths / size));
  if (version === VERSION)
    return [
      { firstBlock: 0, firstGroup: 0, keyframeInfo: readSideInfo(bytes, blocks[groups.length]), latticeShift: 0 },
    ];
  const reader = new ByteReader(bytes, "side information of shots"),
    firsts: number[] = [],
    log2Units: number[] = [],
    parts: Uint8Array[] = [];
  for (let left = reader.unsigned(), group = 0; left > 0; left--) {
    group += reader.unsigned();
    firsts.push(group);
    log2Units.push(version === WITH_MOTION_UNITS ? reader.signed() : 0);
    parts.push(reader.blob());
  }
  reader.finish();
  if (firsts[0] !== 0 || firsts.some((group, n) => group >= (firsts[n + 1] ?? groups.length)))
    throw new BitstreamError(`side information: ${firsts.length} shots do not divide the groups`);
  const shots: Shot[] = [];
  for (let number = 0; number < parts.length; number++) {
    const firstGroup = firsts[number],
      firstBlock = blocks[firstGroup],
      log2Unit = log2Units[number],
      keyframeInfo = readSideInfo(parts[number], blocks[firsts[number + 1] ?? groups.length] - firstBlock),
      first = shots[0]?.keyframeInfo ?? keyframeInfo,
      ratio = keyframeInfo.sizeLog - keyframeInfo.latticeBits - (first.sizeLog - first.latticeBits),
      latticeShift = ratio - log2Unit;
    if (
      keyframeInfo.degree !== first.degree ||
      [ratio, log2Unit, latticeShift].some((octaves) => Math.abs(octaves) > MAX_LOG2_RATIO)
    )
      throw new BitstreamError("side information: a shot does not match the first one");
    shots.push({ firstBlock, firstGroup, keyframeInfo, latticeShift });
    log2MotionUnits.fill(log2Unit, firstGroup, firsts[number + 1]);
  }
  return shots;
}

function readTimeline(bytes: Uint8Array): { version: number; timeline: Timeline } {
  const reader = new ByteReader(bytes, "side information of the clip"),
    version = reader.u8();
  if (version < VERSION || version > WITH_MOTION_UNITS)
    throw new BitstreamError(
      `side information has version ${version}, this version reads ${VERSION} to ${WITH_MOTION_UNITS}`,
    );
  const numerator = reader.unsigned(),
    denominator = reader.unsigned(),
    numFrames = reader.unsigned(),
    groupFrames = reader.unsigned();
  const possible =
    denominator > 0 && denominator <= MAX_FRAMES && numerator > 0 && numerator <= MAX_FRAME_RATE * denominator;
  if (!(possible && numFrames > 0 && numFrames <= MAX_FRAMES && groupFrames > 0 && groupFrames <= MAX_GROUP_FRAMES))
    throw new BitstreamError("side information: the frame rate or the number of frames is out of range");
  reader.finish();
  return { version, timeline: { rate: numerator / denominator, numFrames, groupFrames } };
}

function groupsOf({ tiers }: Manifest): GroupCounts[] {
  const groups: GroupCounts[] = [];
  let firstNew = 0;
  for (let tier = 0; tier < tiers.length; tier += 2) {
    const numBirths = tiers[tier].count,
      numMotionTracks = tiers[tier + 1].count;
    if (numMotionTracks > firstNew + numBirths)
      throw new BitstreamError(`${numMotionTracks} tracks move in a group, but only ${firstNew + numBirths} exist`);
    groups.push({ numBirths, numMotionTracks, firstNew });
    firstNew += numBirths;
  }
  return groups;
}

function readMotion(bytes: Uint8Array): Pick<SequenceInfo, "logStepRatios" | "models"> {
  const reader = new ByteReader(bytes, "side information of motion"),
    logStepRatios = Array.from({ length: NUM_KINDS }, () => reader.signed());
  if (logStepRatios.some((octaves) => Math.abs(octaves) > MAX_LOG_STEP_RATIO))
    throw new BitstreamError("side information: a step of motion is out of range");
  const zero = reader.take(NUM_CONTEXTS);
  reader.finish();
  const models = Int32Array.from(
    { length: 2 * NUM_CONTEXTS },
    (_, i) => Math.min(Math.max(zero[i >> 1], 1), 255) * 256,
  );
  return { logStepRatios, models };
}
