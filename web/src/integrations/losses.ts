// Warnings and errors for incomplete or altered files, and for converted files that lack a part of the scene.

import type { Decoded, Gaussians } from "../decoder.ts";

/** Warns on the console if packets are missing. Throws if the file is complete but its digest is wrong. */
export function warnOfLosses({ packets, expected, complete, verified }: Decoded, name: string): void {
  if (complete && !verified) throw new Error(`${name} was altered or is damaged: its digest does not match`);
  if (!complete) console.warn(`${name}: ${packets} of ${expected} packets received, losses are concealed`);
}

/** Warns on the console if a scene is antialiased or has an origin. Files from other converters contain neither. */
export function warnOfLeftOut({ antialiased, origin }: Gaussians, name: string): void {
  const way = "`splatwire decode` writes files with it";
  if (antialiased) console.warn(`${name}: the scene is antialiased, and the output has no request for it: ${way}`);
  if (origin.some((value) => value !== 0))
    console.warn(`${name}: positions are relative to the origin (${origin.join(", ")}), which is left out: ${way}`);
}
