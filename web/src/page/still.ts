// The picture of a view when nothing changes in it any more.

import type { View } from "../render/view.ts";
import { pause } from "../turns.ts";

const WAIT_MS = 400,
  MOST_LOOKS = 20;

/**
 * A PNG as a data URL. A sort that was under way is followed by that of what changed meanwhile: pictures are taken
 * until two are alike. Sorts take the longer the busier the machine is, as frames do.
 */
export async function stillPicture(view: View): Promise<string> {
  await view.steady();
  await view.frame();
  await view.sorted();
  let before = "",
    now = view.canvas.toDataURL("image/png"),
    wait = WAIT_MS;
  for (let n = 0; n < MOST_LOOKS && now !== before; n++) {
    await pause(wait);
    const began = performance.now();
    await view.frame();
    wait = Math.max(WAIT_MS, 8 * (performance.now() - began));
    [before, now] = [now, view.canvas.toDataURL("image/png")];
  }
  return now;
}
