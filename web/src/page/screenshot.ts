// Screenshots of a view that has settled.

import type { View } from "../render/view.ts";
import { delay } from "../scheduler.ts";

const WAIT_MS = 400,
  MAX_ATTEMPTS = 20;

/**
 * Returns a PNG as a data URL. Takes pictures until two are equal, because depth sorting may lag behind. The waiting
 * time grows with the frame time.
 */
export async function screenshot(view: View): Promise<string> {
  await view.steady();
  await view.frame();
  await view.sorted();
  let before = "",
    now = view.canvas.toDataURL("image/png"),
    wait = WAIT_MS;
  for (let n = 0; n < MAX_ATTEMPTS && now !== before; n++) {
    await delay(wait);
    const began = performance.now();
    await view.frame();
    wait = Math.max(WAIT_MS, 8 * (performance.now() - began));
    [before, now] = [now, view.canvas.toDataURL("image/png")];
  }
  return now;
}
