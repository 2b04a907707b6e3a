// One-file layout (.swz), read incrementally: manifest, side information, then packets.

import { BitstreamError } from "../bytes.ts";
import { sha256 } from "../sha256.ts";
import { MAX_MANIFEST_BYTES, MAX_PACKET_BYTES } from "./limits.ts";
import { isIntactManifest, type Manifest, readManifest } from "./manifest.ts";
import { HEADER_BYTES } from "./packet.ts";

const MAGIC = [0x93, 0x53, 0x57, 0x5a, 1],
  PREFIX = 9;

export interface Head {
  readonly manifest: Manifest;
  readonly sideInfo: Uint8Array;
}

/** Returns the head. Throws `BitstreamError` if the side information does not match the manifest. */
export function checkHead(manifest: Manifest, sideInfo: Uint8Array): Head {
  if (sideInfo.length !== manifest.sideInfoBytes || sha256(sideInfo) !== manifest.sideInfoDigest) {
    throw new BitstreamError("the side information is damaged");
  }
  return { manifest, sideInfo };
}

/** Returns true if the bytes begin with the magic number of a stream. */
export function isStream(bytes: Uint8Array): boolean {
  return MAGIC.every((byte, n) => byte === bytes[n]);
}

/** Returns true if the first bytes of a file contain its whole manifest, but with a wrong digest. */
export function isManifestDamaged(firstBytes: Uint8Array): boolean {
  const end = PREFIX + new DataView(firstBytes.buffer, firstBytes.byteOffset).getUint32(PREFIX - 4, true);
  return end <= firstBytes.length && !isIntactManifest(firstBytes.subarray(PREFIX, end));
}

/** Returns true if the first bytes of two files differ only in the length of the manifest: one is damaged. */
export function differsInLengthOnly(firstBytes: Uint8Array, others: Uint8Array): boolean {
  return firstBytes.every((byte, n) => byte === others[n] || (n >= PREFIX - 4 && n < PREFIX));
}

/** Returns the bytes of a file before its first packet. */
export function fileHead(manifest: Uint8Array, sideInfo: Uint8Array): Uint8Array {
  const bytes = new Uint8Array(PREFIX + manifest.length + sideInfo.length);
  bytes.set(MAGIC);
  new DataView(bytes.buffer).setUint32(5, manifest.length, true);
  bytes.set(manifest, PREFIX);
  bytes.set(sideInfo, PREFIX + manifest.length);
  return bytes;
}

/** Incremental reader for the head of a file: everything before its first packet. */
export class HeadReader {
  head: Head | null = null;
  /** Bytes of the file before its first packet; empty until they are complete. */
  headBytes: Uint8Array = new Uint8Array();
  #manifest: Manifest | null = null;
  /** Bytes of a head that is not complete. */
  begun: Uint8Array = new Uint8Array();

  /**
   * Adds bytes. Returns the bytes after the head once it is complete, otherwise null. Throws `BitstreamError` for an
   * invalid head.
   */
  feed(piece: Uint8Array): Uint8Array | null {
    const bytes = joined(this.begun, piece),
      end = this.#read(bytes);
    this.begun = end ? new Uint8Array() : bytes;
    return end ? bytes.subarray(end) : null;
  }

  #read(bytes: Uint8Array): number {
    if (MAGIC.some((byte, i) => i < bytes.length && bytes[i] !== byte))
      throw new BitstreamError("this is not a splatwire stream");
    if (bytes.length < PREFIX) return 0;
    const size = new DataView(bytes.buffer, bytes.byteOffset).getUint32(5, true);
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

/** Splits a file that arrives in pieces into packets. Data after a packet with an invalid size is discarded. */
export class ContainerReader {
  /** True after a packet with an invalid size. */
  broken = false;
  readonly #begin = new HeadReader();
  #rest: Uint8Array = new Uint8Array();

  get head(): Head | null {
    return this.#begin.head;
  }

  /** Bytes of the file before its first packet; empty until they are complete. */
  get headBytes(): Uint8Array {
    return this.#begin.headBytes;
  }

  /** Adds the next bytes and returns the packets that are now complete, unchecked. */
  feed(piece: Uint8Array): Uint8Array[] {
    const afterHead = this.head ? piece : this.#begin.feed(piece);
    if (!afterHead || this.broken) return [];
    const bytes = joined(this.#rest, afterHead),
      view = new DataView(bytes.buffer, bytes.byteOffset),
      packets: Uint8Array[] = [];
    let offset = 0;
    while (bytes.length - offset >= 4) {
      const size = view.getUint32(offset, true);
      if (size < HEADER_BYTES || size > MAX_PACKET_BYTES) this.broken = true;
      if (this.broken || bytes.length - offset < 4 + size) break;
      packets.push(bytes.slice(offset + 4, offset + 4 + size));
      offset += 4 + size;
    }
    this.#rest = this.broken ? new Uint8Array() : bytes.slice(offset);
    return packets;
  }
}

/** Returns the concatenation of two arrays. */
export function joined(first: Uint8Array, second: Uint8Array): Uint8Array {
  const bytes = new Uint8Array(first.length + second.length);
  bytes.set(first);
  bytes.set(second, first.length);
  return bytes;
}
