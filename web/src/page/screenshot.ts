// Screenshots of a renderer that has settled.

import type { FixedCamera } from "../model/camera.ts";
import type { WebGLRenderer } from "../render/webgl_renderer.ts";
import { delay } from "../scheduler.ts";

const WAIT_MS = 400,
  MAX_ATTEMPTS = 20;

/** Interval of the checks if everything for a picture has arrived, milliseconds. */
const PENDING_MS = 50;

/** The part of `Stage` that pictures use. */
interface Renderable {
  readonly renderer: WebGLRenderer | null;
  withRenderer(work: (renderer: WebGLRenderer) => void): void;
}

/**
 * Makes a picture from a camera, again if the renderer is released meanwhile. Then the page has its own camera again.
 * Throws if drawing fails, or if `losses`, the number of lost WebGL contexts, grows twice.
 */
export async function pictureOf(
  stage: Renderable,
  camera: () => FixedCamera,
  isPending: () => boolean,
  losses: () => number,
): Promise<string> {
  const before = losses();
  for (;;) {
    const renderer = await new Promise<WebGLRenderer>((resolve) => stage.withRenderer(resolve)),
      { fixed } = renderer;
    renderer.fix(camera());
    try {
      await renderer.frame();
      while (isPending() && stage.renderer === renderer) await delay(PENDING_MS);
      const picture = await screenshot(renderer);
      if (stage.renderer === renderer) return picture;
      if (renderer.failed || losses() > before + 1) throw renderer.reason;
    } finally {
      renderer.fix(fixed);
    }
  }
}

/**
 * Returns a PNG as a data URL. Takes pictures until two are equal and no depth sort is pending, because the sorter may
 * still work on the view before. The waiting time grows with the frame time.
 */
async function screenshot(renderer: WebGLRenderer): Promise<string> {
  await renderer.replacementSorted();
  await renderer.frame();
  await renderer.sorted();
  let before = "",
    now = renderer.canvas.toDataURL("image/png"),
    wait = WAIT_MS;
  for (let n = 0; n < MAX_ATTEMPTS && (now !== before || renderer.isSorting); n++) {
    await delay(wait);
    const began = performance.now();
    await renderer.frame();
    wait = Math.max(WAIT_MS, 8 * (performance.now() - began));
    [before, now] = [now, renderer.canvas.toDataURL("image/png")];
  }
  return now;
}
