// Screenshots of a view that has settled.

import type { FixedCamera } from "../model/camera.ts";
import type { View } from "../render/view.ts";
import { delay } from "../scheduler.ts";

const WAIT_MS = 400,
  MAX_ATTEMPTS = 20;

/** Interval of the checks if everything for a picture has arrived, milliseconds. */
const PENDING_MS = 50;

/** The part of `Stage` that pictures use. */
interface Viewing {
  readonly view: View | null;
  draw(work: (view: View) => void): void;
}

/**
 * Makes a picture from a camera, again if the view is released meanwhile. Then the page has its own camera again.
 * Throws if drawing fails, or if `losses`, the number of lost WebGL contexts, grows twice.
 */
export async function pictureOf(
  stage: Viewing,
  camera: () => FixedCamera,
  isPending: () => boolean,
  losses: () => number,
): Promise<string> {
  const before = losses();
  for (;;) {
    const view = await new Promise<View>((resolve) => stage.draw(resolve)),
      { fixed } = view;
    view.fix(camera());
    try {
      await view.frame();
      while (isPending() && stage.view === view) await delay(PENDING_MS);
      const picture = await screenshot(view);
      if (stage.view === view) return picture;
      if (view.failed || losses() > before + 1) throw view.reason;
    } finally {
      view.fix(fixed);
    }
  }
}

/**
 * Returns a PNG as a data URL. Takes pictures until two are equal and no depth sort is pending, because the sorter may
 * still work on the view before. The waiting time grows with the frame time.
 */
async function screenshot(view: View): Promise<string> {
  await view.steady();
  await view.frame();
  await view.sorted();
  let before = "",
    now = view.canvas.toDataURL("image/png"),
    wait = WAIT_MS;
  for (let n = 0; n < MAX_ATTEMPTS && (now !== before || view.isSorting); n++) {
    await delay(wait);
    const began = performance.now();
    await view.frame();
    wait = Math.max(WAIT_MS, 8 * (performance.now() - began));
    [before, now] = [now, view.canvas.toDataURL("image/png")];
  }
  return now;
}
