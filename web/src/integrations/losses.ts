// Warnings and errors for incomplete or altered files.

import type { Decoded } from "../decoder.ts";

/** Warns on the console if packets are missing. Throws if the file is complete but its digest is wrong. */
export function warnOfLosses({ packets, expected, complete, verified }: Decoded, name: string): void {
  if (complete && !verified) throw new Error(`${name} was altered or is damaged: its digest does not match`);
  if (!complete) console.warn(`${name}: ${packets} of ${expected} packets received, losses are concealed`);
}
