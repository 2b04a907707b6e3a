// From the address of a stream to the ways to it.

import { askServer, type Session } from "../transport/webtransport.ts";

export interface Source {
  readonly session: Session | null;
  readonly name: string;
  readonly file: string;
}

/** `https://host/streams/NAME.swz`, whose server may say beside it (`../streams.json`) where it sends datagrams. */
export async function resolveSource(src: string, session: string | null, fingerprint: string | null): Promise<Source> {
  const file = new URL(src, document.baseURI),
    name = decodeURIComponent(file.pathname.split("/").pop() ?? "").replace(/\.swz$/, "");
  const given = session ? { url: session, ...(fingerprint ? { fingerprint } : {}) } : await askServer(file);
  return { session: given, name, file: file.href };
}
