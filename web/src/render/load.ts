// The drawing is a bundle of its own, beside the page's: a preview does not wait for it.

import type { View } from "./view.ts";

declare global {
  /** Set by the drawing's bundle, whether it was loaded or is a part of the same file. */
  var splatwireView: typeof View | undefined;
}

/** What draws with WebGL. Throws where it cannot be loaded. */
export async function loadView(): Promise<typeof View> {
  if (!globalThis.splatwireView) await import(new URL("splatwire-view.js", import.meta.url).href);
  return globalThis.splatwireView!;
}
