// How long the decoder takes; run by scripts/time.mjs.

import { StreamDecoder } from "../src/codec/decoder.ts";
import { readStream } from "./vectors.ts";

/** Processor time of one pass over a stream, side information included, microseconds for each Gaussian. */
export function decodeTime(path: string): number {
  const { head, packets } = readStream(path), began = process.cpuUsage(), decoder = new StreamDecoder(head);
  let count = 0;
  for (const bytes of packets) count += decoder.take(bytes)?.splats.count ?? 0;
  const { user, system } = process.cpuUsage(began);
  return (user + system) / count;
}
