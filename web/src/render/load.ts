// Loads the renderer, a bundle separate from the page's so that a preview does not wait for it.

import { waitOrOnline } from "../transport/backoff.ts";
import { isFinal } from "../transport/http_error.ts";
import { permitted } from "../transport/page_policy.ts";
import type { WebGLRenderer } from "./webgl_renderer.ts";

/**
 * Name of the global variable that the renderer's bundle sets, in a separate or the same file. It includes the build,
 * because a cache may deliver the bundle of another version.
 */
export const RENDERER = `splatwireView${BUILD}`;

/** Delays before the bundle is requested again, milliseconds, as for a server that is busy or restarting. */
const RETRIES_MS = [500, 1000, 2000, 4000, 8000];

let loading: Promise<void> | null = null;
/** Number of requests for the bundle. Browsers remember a failed import, so each one needs its own URL. */
let requests = 0;

const rendererOf = (): typeof WebGLRenderer | undefined =>
  (globalThis as Record<string, unknown>)[RENDERER] as typeof WebGLRenderer;

/** Returns the WebGL renderer. Throws if it cannot be loaded. */
export async function loadRenderer(): Promise<typeof WebGLRenderer> {
  if (!rendererOf()) await (loading ??= load().finally(() => (loading = null)));
  return rendererOf()!;
}

async function load(): Promise<void> {
  const url = new URL("splatwire-view.js", import.meta.url);
  for (let n = 0; ; n++) {
    if (requests) url.searchParams.set("retry", String(requests));
    requests++;
    try {
      await permitted(url.href, import(url.href));
      if (rendererOf()) return;
      throw new Error("a renderer of another version");
    } catch (error) {
      if (n === RETRIES_MS.length || isFinal(error)) throw error;
      await waitOrOnline(RETRIES_MS[n]);
    }
  }
}
