// What a way to a stream tells whoever opened it.

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

export interface Listener {
  preview(bytes: Uint8Array): void;
  /**
   * `file` has the bytes of the stream's file up to its first packet; `keep`: whether the file will be the same later.
   */
  head(head: Head, file: Uint8Array, keep: boolean): void;
  packets(packets: readonly Arrived[]): void;
  counts(counts: Counts): void;
  stopped(): boolean;
}
