// From the address of a stream to the ways to it.

import { type Source, sourceOf } from "../transport/attempts.ts";

/** `https://host/streams/NAME.swz`, whose server may say beside it (`../streams.json`) where it sends datagrams. */
export function resolveSource(src: string, session: string | null, fingerprint: string | null): Promise<Source> {
  return sourceOf(
    new URL(src, document.baseURI),
    session ? { url: session, ...(fingerprint ? { fingerprint } : {}) } : null,
  );
}
