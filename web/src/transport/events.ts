// Interface between the sources of a stream and its receiver.

import type { ViewCamera } from "../codec/levels/cut.ts";
import type { Tiles } from "../codec/levels/tiles.ts";
import type { Head } from "../packets/container.ts";

export interface Counts {
  /** Transport of the packets, for the panel. */
  readonly transport: string;
  readonly bytes: number;
  readonly packets: number;
  readonly expected: number;
  /** Datagrams lost on the path; 0 for reliable transports. */
  readonly lost: number;
  readonly rejected: number;
  readonly seconds: number;
}

/** Order of the packets in the stream's file. That of a session is its `Welcome.orderDigest`. */
export const FILE_ORDER = "file";

/** Order of packets with an uncertain position. */
export const UNKNOWN_ORDER = "";

/** A packet and its position in an order. Block and index in its header identify it. */
export interface ReceivedPacket {
  /** Order in which `position` counts: `FILE_ORDER`, `UNKNOWN_ORDER`, or the digest of a session's sending order. */
  readonly order: string;
  /** In a file: offset of the size field, bytes. In a session: index in the sending order. */
  readonly position: number;
  readonly bytes: Uint8Array;
}

/** Tiles requested by the view of a scene with levels. */
export interface TileRequest {
  readonly head: Head;
  readonly tiles: Pick<Tiles, "offsets">;
  /** Missing tiles, most useful first. */
  readonly wanted: readonly number[];
  /** Number of received packets. */
  readonly packets: number;
  /** Returns the number of missing packets of a tile. */
  missing(tile: number): number;
  /** Resolves when the view needs tiles that are not given up. */
  nextView(isGivenUp: (tile: number) => boolean): Promise<void>;
  /** Resolves when all received packets are decoded. */
  decoded(): Promise<void>;
}

export interface Listener {
  /** Tiles requested by the view; null for streams without levels or before the first view. */
  readonly tileRequest?: TileRequest | null;
  /** Camera of the view, a new object for each change. Null before the first one, absent without a view. */
  readonly camera?: ViewCamera | null;
  /** Called when all tiles of the view were sent. */
  viewComplete?(): void;
  /** Called when the server confirmed that the stored packets belong to the current stream. */
  confirmed?(): void;
  /** Called when the stream was replaced, so that all stored packets are obsolete. */
  changed?(): void;
  preview(bytes: Uint8Array): void;
  /**
   * Processes a head. `fileHead` is the stream's file up to its first packet. `keep` is true if the file is final and
   * can be cached. `live` is true for all heads of a live clip, including the last one.
   */
  head(head: Head, fileHead: Uint8Array, keep: boolean, live?: boolean): void;
  packets(packets: readonly ReceivedPacket[]): void;
  counts(counts: Counts): void;
  stopped(): boolean;
}
