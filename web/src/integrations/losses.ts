// Warnings and errors for incomplete or altered files, and for converted files that lack a part of the scene.

import type { Decoded, Progress, Scene } from "../decoder.ts";

/** Warns on the console if packets are missing. Throws if the file is complete but its digest is wrong. */
export function warnOfLosses(received: Decoded, name: string): void {
  if (received.complete && !received.verified)
    throw new Error(`${name} was altered or is damaged: its digest does not match`);
  warnOfMissing(received, name);
}

/** Warns on the console if packets are missing. */
export function warnOfMissing({ packets, expected }: Pick<Progress, "packets" | "expected">, name: string): void {
  if (packets < expected) console.warn(`${name}: ${packets} of ${expected} packets received, losses are concealed`);
}

/**
 * Warns on the console if a scene is antialiased, or has an origin or a background colour. Files from other converters
 * contain none of them.
 */
export function warnOfLeftOut({ gaussians: { antialiased, origin }, background }: Scene, name: string): void {
  const way = "`splatwire decode` writes files with it";
  if (antialiased) console.warn(`${name}: the scene is antialiased, but the output has no mark of it: ${way}`);
  if (origin.some((value) => value !== 0))
    console.warn(`${name}: positions are relative to the origin (${origin.join(", ")}), which is left out: ${way}`);
  if (background.some((value) => value !== 0)) {
    const colour = background.map((value) => Number(value.toPrecision(3))).join(", ");
    console.warn(`${name}: the background colour (${colour}) is left out: such files have none`);
  }
}
