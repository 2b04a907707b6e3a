// From the address of a stream to the ways to it.

import type { Session } from "../transport/webtransport.ts";

export interface Source {
  readonly session: Session | null;
  readonly name: string;
  readonly file: string;
}

/** `https://host/streams/NAME.swz`, whose server may say beside it (`../streams.json`) where it sends datagrams. */
export async function resolveSource(src: string, session: string | null, fingerprint: string | null): Promise<Source> {
  const file = new URL(src, document.baseURI), name = decodeURIComponent(file.pathname.split("/").pop() ?? "").replace(/\.swz$/, "");
  const given = session ? { url: session, ...(fingerprint ? { fingerprint } : {}) } : await askServer(file);
  return { session: given, name, file: file.href };
}

/** Where a server's page says that it takes sessions; none where it is no such server. */
async function askServer(file: URL): Promise<Session | null> {
  if (!file.pathname.includes("/streams/")) return null;
  try {
    const answer = await fetch(new URL("../streams.json", file));
    const { port, path, fingerprint } = (await answer.json()) as Record<string, unknown>;
    if (!answer.ok || typeof port !== "number" || typeof path !== "string") return null;
    const url = `https://${file.hostname}:${port}${path}`;
    return typeof fingerprint === "string" ? { url, fingerprint } : { url };
  } catch {
    return null;
  }
}
