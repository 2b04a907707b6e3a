// The one-file layout (.swz), read while it comes: manifest and side information first, then packets one by one.

import { sha256 } from "@noble/hashes/sha2.js";

import { BitstreamError, hex } from "../bytes.ts";
import { MAX_MANIFEST_BYTES, MAX_PACKET_BYTES } from "./limits.ts";
import { type Manifest, readManifest } from "./manifest.ts";

const MAGIC = [0x93, 0x53, 0x57, 0x5a, 1],
  PREFIX = 9;

export interface Head {
  readonly manifest: Manifest;
  readonly sideInfo: Uint8Array;
}

/** Checks side information against its manifest. */
export function checkHead(manifest: Manifest, sideInfo: Uint8Array): Head {
  if (sideInfo.length !== manifest.sideInfoBytes || hex(sha256(sideInfo)) !== manifest.sideInfoDigest) {
    throw new BitstreamError("the side information is damaged");
  }
  return { manifest, sideInfo };
}

/** Returns True if bytes begin as every stream's file does. */
export function isStream(bytes: Uint8Array): boolean {
  return MAGIC.every((byte, n) => byte === bytes[n]);
}

/** A file up to its first packet. */
export function fileHead(manifest: Uint8Array, sideInfo: Uint8Array): Uint8Array {
  const bytes = new Uint8Array(PREFIX + manifest.length + sideInfo.length);
  bytes.set(MAGIC);
  new DataView(bytes.buffer).setUint32(5, manifest.length, true);
  bytes.set(manifest, PREFIX);
  bytes.set(sideInfo, PREFIX + manifest.length);
  return bytes;
}

/** Cuts a file that comes in pieces. After a packet whose size cannot be true the rest is left. */
export class ContainerReader {
  head: Head | null;
  /** The file up to its first packet, once that is there. */
  headBytes: Uint8Array = new Uint8Array();
  /** Whether the rest cannot be read. */
  broken = false;
  #manifest: Manifest | null = null;
  #rest = new Uint8Array();

  /** `head`: where what comes begins with a packet. */
  constructor(head: Head | null = null) {
    this.head = head;
  }

  /** Packets (their bytes, unchecked) that are complete now. */
  feed(piece: Uint8Array): Uint8Array[] {
    const bytes = new Uint8Array(this.#rest.length + piece.length),
      packets: Uint8Array[] = [];
    bytes.set(this.#rest);
    bytes.set(piece, this.#rest.length);
    const view = new DataView(bytes.buffer);
    let at = this.head ? 0 : this.#readHead(bytes, view);
    while (this.head && !this.broken && bytes.length - at >= 4) {
      const size = view.getUint32(at, true);
      if (size < 16 || size > MAX_PACKET_BYTES) this.broken = true;
      if (this.broken || bytes.length - at < 4 + size) break;
      packets.push(bytes.slice(at + 4, at + 4 + size));
      at += 4 + size;
    }
    this.#rest = this.broken ? new Uint8Array() : bytes.slice(at);
    return packets;
  }

  #readHead(bytes: Uint8Array, view: DataView): number {
    if (MAGIC.some((byte, i) => i < bytes.length && bytes[i] !== byte))
      throw new BitstreamError("this is not a splatwire stream");
    if (bytes.length < PREFIX) return 0;
    const size = view.getUint32(5, true);
    if (size > MAX_MANIFEST_BYTES) throw new BitstreamError(`a manifest cannot have ${size} bytes`);
    if (bytes.length < PREFIX + size) return 0;
    this.#manifest ??= readManifest(bytes.subarray(PREFIX, PREFIX + size));
    const end = PREFIX + size + this.#manifest.sideInfoBytes;
    if (bytes.length < end) return 0;
    this.head = checkHead(this.#manifest, bytes.slice(PREFIX + size, end));
    this.headBytes = bytes.slice(0, end);
    return end;
  }
}
