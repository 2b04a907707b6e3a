// First and last frames of tracks. Their named section survives the loss of motion packets.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import { LIFETIMES } from "../../packets/section_names.ts";
import type { GroupCounts, Timeline } from "./timeline.ts";

/** Lifetimes by track. Other tracks are treated as if they began with their birth group and did not end. */
export interface Lifetimes {
  /** First frame, relative to the group that the track is born in. */
  readonly begins: ReadonlyMap<number, number>;
  /** End frame of the track, counted from the first frame of the clip. */
  readonly ends: ReadonlyMap<number, number>;
}

export function readLifetimes(
  sections: ReadonlyMap<string, Uint8Array>,
  groups: readonly GroupCounts[],
  { numFrames, groupFrames }: Timeline,
): Lifetimes {
  const begins = new Map<number, number>(),
    ends = new Map<number, number>(),
    found = { begins, ends },
    bytes = sections.get(LIFETIMES);
  if (!bytes) return found;
  const reader = new ByteReader(bytes, `section '${LIFETIMES}'`),
    { firstNew, numBirths } = groups[groups.length - 1];
  for (const values of [begins, ends]) {
    let track = -1;
    for (let left = reader.unsigned(); left > 0; left--) {
      track += reader.unsigned() + 1;
      const frame = reader.unsigned();
      if (track >= firstNew + numBirths || frame > numFrames)
        throw new BitstreamError(`section '${LIFETIMES}': track ${track} and frame ${frame} are not in the clip`);
      values.set(track, frame);
    }
  }
  reader.finish();
  for (const values of [begins, ends]) {
    let group = 0;
    for (const track of values.keys()) {
      while (track >= groups[group].firstNew + groups[group].numBirths) group++;
      const begin = begins.get(track) ?? 0;
      if (begin >= groupFrames || group * groupFrames + begin >= (ends.get(track) ?? numFrames))
        throw new BitstreamError(`section '${LIFETIMES}': a track ends before it begins`);
    }
  }
  return found;
}
