// Memory limit of a stream, proportional to the received bytes. Counterpart of `splatwire.codec.memory`.

import { BitstreamError } from "../bytes.ts";
import { BYTES_PER_BYTE, FREE_BYTES } from "../packets/limits.ts";

/** Memory of concealment per element of the scene, received or lost, bytes. */
export const CONCEALMENT_BYTES = 96;

/** Returns the memory that decoded elements may take for `arrived` received bytes. */
export const allowedMemory = (arrived: number): number => FREE_BYTES + BYTES_PER_BYTE * arrived;

/**
 * Throws `BitstreamError` if `needed` bytes of memory exceed the limit for `arrived` received bytes. `activity` begins
 * the message.
 */
export function checkMemory(needed: number, arrived: number, activity: string): void {
  const allowed = allowedMemory(arrived);
  if (needed <= allowed) return;
  const [wanted, most] = [needed, allowed].map((bytes) => `${Math.ceil(bytes / 1e6)} MB`);
  throw new BitstreamError(`${activity} needs ${wanted} of memory; the limit for ${arrived} received bytes is ${most}`);
}
