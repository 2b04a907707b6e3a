// Updates of a scene over HTTP: a file in the folder of the scene's file, named after the state that it changes.

import { sha256 } from "../sha256.ts";
import { HttpError } from "./http_error.ts";

/** Letters of the digest in the name of an update, as in `splatwire.codec.update.section.update_name`. */
const NAME_LETTERS = 16;
/** Largest size of an update or of a scene that is requested again, bytes. */
const MAX_FILE_BYTES = 2 ** 30;
/** Size of the first bytes of a scene that are searched for its manifest, bytes. */
const MAX_BEGIN_BYTES = 2 ** 20;
/** Time without data after which a request is given up, milliseconds. */
const IDLE_MS = 30_000;

/** Bytes of a file before its manifest: magic number, version and size of the manifest. */
const PREFIX_BYTES = 9;

/** Returns the first bytes of a file up to the end of its manifest. */
export const fileManifest = (file: Uint8Array): Uint8Array => file.subarray(0, manifestEnd(file));

const manifestEnd = (file: Uint8Array): number =>
  PREFIX_BYTES + new DataView(file.buffer, file.byteOffset, file.byteLength).getUint32(PREFIX_BYTES - 4, true);

/** Returns the SHA-256 of a manifest, hexadecimal. `file` are the first bytes of a file, up to the end of it. */
export const manifestDigest = (file: Uint8Array): string => sha256(file.subarray(PREFIX_BYTES));

/** Returns the address of the update of a scene with this digest. It keeps the query, which may have a token. */
export const updateUrl = (file: string, digest: string): string =>
  new URL(`update.${digest.slice(0, NAME_LETTERS)}.swz${new URL(file).search}`, file).href;

/**
 * Returns the content of a file; null if it does not exist. Also null for a stream with the digest `known` in
 * its manifest, without downloading the rest. Throws if the server refuses, sends more than `most` bytes, or sends
 * nothing for `IDLE_MS`.
 */
export async function readWhole(url: string, most = MAX_FILE_BYTES, known = ""): Promise<Uint8Array | null> {
  const stop = new AbortController(),
    pieces: Uint8Array<ArrayBuffer>[] = [];
  let size = 0,
    timer: ReturnType<typeof setTimeout> | undefined;
  const restart = () => {
    clearTimeout(timer);
    timer = setTimeout(() => stop.abort(new Error("the server sends nothing")), IDLE_MS);
  };
  try {
    restart();
    const answer = await fetch(url, { cache: "no-store", signal: stop.signal });
    if (answer.status === 404) return null;
    if (!answer.ok) throw new HttpError(url, answer);
    const reader = answer.body!.getReader();
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
      restart();
      size += next.value.length;
      if (size > most) throw new Error("the file is too large");
      pieces.push(next.value);
      if (!known || size < PREFIX_BYTES) continue;
      const begin = new Uint8Array(await new Blob(pieces).arrayBuffer()),
        manifest = fileManifest(begin);
      if (manifest.length < manifestEnd(begin) && size < MAX_BEGIN_BYTES) continue;
      if (manifestDigest(manifest) === known) return null;
      known = "";
    }
  } finally {
    clearTimeout(timer);
    stop.abort();
  }
  return new Uint8Array(await new Blob(pieces).arrayBuffer());
}
