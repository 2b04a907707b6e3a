// What a way to a stream tells whoever opened it.

import type { Look } from "../codec/levels/cut.ts";
import type { Tiles } from "../codec/levels/tiles.ts";
import type { Head } from "../packets/container.ts";

export interface Counts {
  /** How it travels, in words for people. */
  readonly way: string;
  readonly bytes: number;
  readonly packets: number;
  readonly expected: number;
  /** Datagrams that the path lost; 0 where it cannot. */
  readonly lost: number;
  readonly rejected: number;
  readonly seconds: number;
}

/** A packet and its place in the sending order, which is that of the file. */
export interface Arrived {
  readonly place: number;
  readonly bytes: Uint8Array;
}

/** What a view wants of a scene with levels. */
export interface Fetching {
  readonly head: Head;
  readonly tiles: Pick<Tiles, "offsets" | "firstPackets">;
  /** Tiles that are not there, the most useful first. */
  readonly wanted: readonly number[];
  /** Packets that are there. */
  readonly packets: number;
  /** Number of packets of a tile that are missing. */
  missing(tile: number): number;
  /** Resolves when the view wants tiles that are not given up. */
  moved(isGivenUp: (tile: number) => boolean): Promise<void>;
  /** Resolves when all that came is decoded. */
  taken(): Promise<void>;
}

export interface Listener {
  /** What the view wants of a stream whose head came; none of one without levels, or where there is no view. */
  readonly fetching?: Fetching | null;
  /** Where somebody looks from, a new object for each place; null before it is known, none where nobody looks. */
  readonly looking?: Look | null;
  /** All that they look at was sent. */
  sawAll?(): void;
  /** Held packets are of the stream as it is now. */
  confirmed?(): void;
  /** The stream was replaced: all held packets have to be forgotten. */
  changed?(): void;
  preview(bytes: Uint8Array): void;
  /**
   * `file` has the bytes of the stream's file up to its first packet; `keep`: whether the file will be the same later;
   * `live`: whether the stream grows, and another one may follow.
   */
  head(head: Head, file: Uint8Array, keep: boolean, live?: boolean): void;
  packets(packets: readonly Arrived[]): void;
  counts(counts: Counts): void;
  stopped(): boolean;
}
