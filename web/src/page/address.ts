// Resolves the element's attributes to a stream's sources.

import { nameOf, type Source, sourceOf } from "../transport/failover.ts";

/**
 * Returns the sources of `https://host/streams/NAME.swz`. The server may publish its WebTransport session in
 * `../streams.json`.
 *
 * A session `:PORT/PATH` is on the host of the stream, because a server behind a proxy does not know its public name.
 */
export function resolveSource(file: URL, session: string | null, fingerprint: string | null): Promise<Source> {
  const url = session?.startsWith(":") ? `https://${file.hostname}${session}` : session;
  return sourceOf(file, url ? { url, ...(fingerprint ? { fingerprint } : {}) } : null);
}

/** Returns the absolute address of `src`; null if it is not a valid URL. */
export function addressOf(src: string, base?: string): URL | null {
  try {
    return new URL(src, base);
  } catch {
    return null;
  }
}

/** Returns the scene's title: the element's `aria-label`, the name of a file on a server, or the title of the page. */
export function titleOf(host: HTMLElement): string {
  const src = host.getAttribute("src") ?? "",
    file = /^\s*(blob|data):/i.test(src) ? "" : nameOf(src.split(/[?#]/)[0]);
  return host.getAttribute("aria-label") || file || host.ownerDocument.title || "Scene";
}
