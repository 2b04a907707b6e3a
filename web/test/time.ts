// How long the decoder takes; run by scripts/time.mjs.

import { StreamDecoder } from "../src/codec/decoder.ts";
import type { Part } from "../src/codec/part.ts";
import { pack } from "../src/render/packed.ts";
import { readStream } from "./vectors.ts";

/**
 * Processor time, microseconds for each element: of a pass over a stream, side information included, and of asking, not
 * for the first time, for all that a camera sees.
 */
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
    parts = packets.map((bytes) => decoder.take(bytes)).filter((part): part is Part => part !== null);
  const decode = took(),
    { middle, size } = decoder.schema,
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
  for (const part of parts) part.seen(camera);
  took();
  for (const part of parts) part.seen(camera);
  return { decode, view: took() };
}

/**
 * Processor time of playing a clip for the first time, all of which is there; null of a scene. Milliseconds a frame,
 * from payloads to what is handed to the graphics card: the mean, and the slowest, which is the first of a group where
 * its motion was not made ready.
 */
export function clipTimes(path: string): { ms: number; slowest: number } | null {
  const { head, packets } = readStream(path),
    decoder = new StreamDecoder(head);
  for (const bytes of packets) decoder.take(bytes);
  const { degree, size, moving } = decoder.schema;
  if (!moving) return null;
  const times: number[] = [],
    all = () => true;
  for (let number = 0; number < moving.times.numFrames; number++) {
    const began = process.cpuUsage();
    pack([moving.frame(number, all, "motion").splats], degree, size);
    const { user, system } = process.cpuUsage(began);
    times.push((user + system) / 1000);
  }
  return { ms: times.reduce((sum, time) => sum + time, 0) / times.length, slowest: Math.max(...times) };
}
