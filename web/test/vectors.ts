// Shared test data: streams of the repository, and reproducible random numbers.

import { readFileSync } from "node:fs";

import { ContainerReader, type Head } from "../src/packets/container.ts";

export function readStream(path: string): { head: Head; packets: Uint8Array[] } {
  const reader = new ContainerReader(),
    packets = reader.feed(new Uint8Array(readFileSync(path)));
  if (!reader.head) throw new Error(`${path} is cut`);
  return { head: reader.head, packets };
}

export const fileOf = (path: string): Uint8Array => new Uint8Array(readFileSync(path));

/** Tested streams, from the variable STREAMS. */
export const STREAMS = [...(process.env["STREAMS"] ?? "").split(":").filter(Boolean)];

/** Returns a generator of numbers in [0, 1) (mulberry32). */
export function random(seed: number): () => number {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}
