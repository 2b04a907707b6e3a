// From the address of a stream to the ways to it.

import { type Source, sourceOf } from "../transport/attempts.ts";

/**
 * `https://host/streams/NAME.swz`, whose server may say beside it (`../streams.json`) where it sends datagrams. A
 * session `:PORT/PATH` is at the host of the stream: a server behind a proxy does not know its own name.
 */
export function resolveSource(file: URL, session: string | null, fingerprint: string | null): Promise<Source> {
  const url = session?.startsWith(":") ? `https://${file.hostname}${session}` : session;
  return sourceOf(file, url ? { url, ...(fingerprint ? { fingerprint } : {}) } : null);
}

/** What a scene is called: by the page, else as its file is, else as the page is. */
export function titleOf(host: HTMLElement): string {
  const file = (host.getAttribute("src") ?? "")
    .split(/[?#]/)[0]
    .split("/")
    .pop()!
    .replace(/\.swz$/, "");
  return host.getAttribute("aria-label") || decoded(file) || host.ownerDocument.title || "Scene";
}

function decoded(name: string): string {
  try {
    return decodeURIComponent(name);
  } catch {
    return name; // a percent sign that is meant as one
  }
}
