// Loads the renderer, a bundle separate from the page's so that a preview does not wait for it.

import { waitOrOnline } from "../transport/backoff.ts";
import type { View } from "./view.ts";

declare global {
  /** Set by the renderer's bundle, in a separate or the same file. */
  var splatwireView: typeof View | undefined;
}

/** Delays before the bundle is requested again, milliseconds, as for a server that is busy or restarting. */
const RETRIES_MS = [500, 1000, 2000, 4000, 8000];

let loading: Promise<void> | null = null;

/** Returns the WebGL renderer. Throws if it cannot be loaded. */
export async function loadView(): Promise<typeof View> {
  if (!globalThis.splatwireView) await (loading ??= load().finally(() => (loading = null)));
  return globalThis.splatwireView!;
}

async function load(): Promise<void> {
  const url = new URL("splatwire-view.js", import.meta.url);
  for (let n = 0; ; n++) {
    try {
      return void (await import(url.href));
    } catch (error) {
      if (n === RETRIES_MS.length) throw error;
      await waitOrOnline(RETRIES_MS[n]);
      url.searchParams.set("retry", String(n + 1)); // browsers remember a failed import
    }
  }
}
