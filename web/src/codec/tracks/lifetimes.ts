// When tracks come and go: a named section, so that it is not lost with the motion of a group.

import { BitstreamError, ByteReader } from "../../bytes.ts";
import type { Group, Timeline } from "./timeline.ts";

const SECTION = "lifetimes";

/** By track; those that it does not tell about come with the group that they are born in, and stay. */
export interface Lifetimes {
  /** First frame, counted from that of the group that the track is born in. */
  readonly begins: ReadonlyMap<number, number>;
  /** First frame of the clip after the track. */
  readonly ends: ReadonlyMap<number, number>;
}

export function readLifetimes(
  sections: ReadonlyMap<string, Uint8Array>,
  groups: readonly Group[],
  { numFrames, groupFrames }: Timeline,
): Lifetimes {
  const begins = new Map<number, number>(),
    ends = new Map<number, number>(),
    found = { begins, ends },
    bytes = sections.get(SECTION);
  if (!bytes) return found;
  const reader = new ByteReader(bytes, `section '${SECTION}'`),
    { firstNew, births } = groups[groups.length - 1];
  for (const values of [begins, ends]) {
    let track = -1;
    for (let left = reader.unsigned(); left > 0; left--) {
      track += reader.unsigned() + 1;
      const frame = reader.unsigned();
      if (track >= firstNew + births || frame > numFrames)
        throw new BitstreamError(`section '${SECTION}': track ${track} and frame ${frame} are not in the clip`);
      values.set(track, frame);
    }
  }
  reader.finish();
  for (const values of [begins, ends]) {
    let group = 0;
    for (const track of values.keys()) {
      while (track >= groups[group].firstNew + groups[group].births) group++;
      const begin = begins.get(track) ?? 0;
      if (begin >= groupFrames || group * groupFrames + begin >= (ends.get(track) ?? numFrames))
        throw new BitstreamError(`section '${SECTION}': a track ends before it begins`);
    }
  }
  return found;
}
