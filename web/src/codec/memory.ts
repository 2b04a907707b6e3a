// How much memory a stream may take: in proportion to the bytes that arrived, the twin of `splatwire.codec.memory`.

import { BitstreamError } from "../bytes.ts";
import { BYTES_PER_BYTE, FREE_BYTES } from "../packets/limits.ts";

/** Memory that a concealer takes for each element of a scene, lost ones, too. */
export const LOOKED_AT_BYTES = 96;

/** Throws where something would take more memory than a stream may of which so many bytes arrived. */
export function checkMemory(needed: number, arrived: number, what: string): void {
  const allowed = FREE_BYTES + BYTES_PER_BYTE * arrived;
  if (needed <= allowed) return;
  const [wanted, most] = [needed, allowed].map((bytes) => `${Math.ceil(bytes / 1e6)} MB`);
  throw new BitstreamError(
    `${what} would take ${wanted} of memory, and a stream of which ${arrived} bytes arrived may take ${most}`,
  );
}
