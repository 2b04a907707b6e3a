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

export interface Listener {
  preview(bytes: Uint8Array): void;
  head(head: Head): void;
  packets(packets: Uint8Array[]): void;
  counts(counts: Counts): void;
  stopped(): boolean;
}
