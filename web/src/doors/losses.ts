// Honest words where a file is not what was encoded.

import type { Decoded } from "../decoder.ts";

/** Warns on the console where packets are missing. Throws where all are there and their integers are other ones. */
export function warnOfLosses({ packets, expected, complete, verified }: Decoded, name: string): void {
  if (complete && !verified) throw new Error(`${name} was altered or is damaged: its digest does not match`);
  if (!complete) console.warn(`${name}: ${packets} of ${expected} packets are there, losses are concealed`);
}
