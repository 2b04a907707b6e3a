// Decoding times, for scripts/time.mjs.

import { StreamDecoder } from "../src/codec/decoder.ts";
import type { ElementBatch } from "../src/codec/element_batch.ts";
import { pack } from "../src/render/packed.ts";
import { readStream } from "./vectors.ts";

/** Returns processor times in microseconds per element: decoding including the side information, and a later view. */
export function passTimes(path: string): { decode: number; view: number } {
  const { head, packets } = readStream(path),
    { count } = head.manifest;
  let began = process.cpuUsage();
  const took = (): number => {
    const { user, system } = process.cpuUsage(began);
    began = process.cpuUsage();
    return (user + system) / count;
  };
  const decoder = new StreamDecoder(head),
    parts = packets.map((bytes) => decoder.addPacket(bytes)).filter((part): part is ElementBatch => part !== null);
  const decode = took(),
    { middle, size } = decoder.elementDecoder,
    [x, y, z] = middle ?? [0, 0, 0];
  const camera = {
    viewmat: [
      [1, 0, 0, -x],
      [0, 1, 0, -y],
      [0, 0, 1, 6 * size - z],
    ],
    focal: 400,
    width: 800,
    height: 800,
    margin: 200,
  };
  for (const part of parts) part.forCamera(camera);
  took();
  for (const part of parts) part.forCamera(camera);
  return { decode, view: took() };
}

/**
 * Returns processor times in milliseconds per frame for the first playback of a complete clip; null for static scenes.
 *
 * A frame includes decoding and packing for the GPU. The slowest frame is the first of a group whose motion was not
 * decoded in advance.
 */
export function clipTimes(path: string): { ms: number; slowest: number } | null {
  const { head, packets } = readStream(path),
    decoder = new StreamDecoder(head);
  for (const bytes of packets) decoder.addPacket(bytes);
  const { degree, size, sequence } = decoder.elementDecoder;
  if (!sequence) return null;
  const times: number[] = [],
    all = () => true;
  for (let number = 0; number < sequence.timeline.numFrames; number++) {
    const began = process.cpuUsage();
    pack([sequence.frame(number, all, "motion", true).splats], degree, size);
    const { user, system } = process.cpuUsage(began);
    times.push((user + system) / 1000);
  }
  return { ms: times.reduce((sum, time) => sum + time, 0) / times.length, slowest: Math.max(...times) };
}
