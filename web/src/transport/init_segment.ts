// Init segment of a stream, assembled from symbols: manifest, side information and bundled packets.

import { hex } from "../bytes.ts";
import { checkHead, fileHead, type Head } from "../packets/container.ts";
import { readManifest } from "../packets/manifest.ts";
import { sha256 } from "../sha256.ts";
import { dataView, type Welcome } from "./wire_messages.ts";

const SOURCE_BLOCK_SYMBOLS = 2048;

export class InitSegment {
  readonly numSymbols: number;
  readonly #bytes: Uint8Array;
  readonly #received: Uint8Array;
  #count = 0;

  constructor(readonly welcome: Welcome) {
    this.numSymbols = Math.ceil(welcome.initSegmentBytes / welcome.symbolBytes);
    this.#bytes = new Uint8Array(welcome.initSegmentBytes);
    this.#received = new Uint8Array(this.numSymbols);
  }

  /** Number of missing symbols. */
  get missing(): number {
    return this.numSymbols - this.#count;
  }

  /** Returns the stream's file up to its first packet. Call it only after all symbols arrived. */
  fileHead(head: Head): Uint8Array {
    const size = dataView(this.#bytes).getUint32(0, true);
    return fileHead(this.#bytes.subarray(4, 4 + size), head.sideInfo);
  }

  /** SHA-256 of the segment, hexadecimal. */
  get digest(): string {
    return sha256(this.#bytes);
  }

  /** Returns true if another init segment begins with the same manifest. */
  hasManifestOf(other: Uint8Array): boolean {
    const end = 4 + dataView(this.#bytes).getUint32(0, true);
    return other.length >= end && hex(this.#bytes.subarray(0, end)) === hex(other.subarray(0, end));
  }

  /** Adds a symbol. Returns false if it does not fit. */
  add(bytes: Uint8Array): boolean {
    const { symbolBytes, initSegmentBytes } = this.welcome,
      view = dataView(bytes),
      numSourceBlocks = Math.ceil(this.numSymbols / SOURCE_BLOCK_SYMBOLS),
      sourceBlock = view.getUint16(9, true),
      payload = bytes.subarray(15, bytes.length - 4),
      symbolIndex = Math.floor((this.numSymbols * sourceBlock) / numSourceBlocks) + view.getUint32(11, true),
      next = Math.floor((this.numSymbols * (sourceBlock + 1)) / numSourceBlocks);
    if (sourceBlock >= numSourceBlocks || symbolIndex >= next || payload.length !== symbolBytes) return false;
    if (this.#received[symbolIndex]) return true; // a duplicate from the other transport
    this.#bytes.set(
      payload.subarray(0, Math.min(symbolBytes, initSegmentBytes - symbolIndex * symbolBytes)),
      symbolIndex * symbolBytes,
    );
    this.#received[symbolIndex] = 1;
    this.#count++;
    return true;
  }

  /** Returns the head and the bundled packets. Throws if they are damaged. */
  read(): { head: Head; bundled: Uint8Array[] } {
    const bytes = this.#bytes,
      view = dataView(bytes),
      bundled: Uint8Array[] = [];
    if (this.digest !== hex(this.welcome.digest)) throw new Error("the init segment is damaged");
    const manifestEnd = 4 + (bytes.length >= 4 ? view.getUint32(0, true) : 0),
      manifest = readManifest(bytes.subarray(4, manifestEnd));
    let offset = manifestEnd + manifest.sideInfoBytes;
    const head = checkHead(manifest, bytes.subarray(manifestEnd, offset));
    for (; offset + 2 <= bytes.length && bundled.length < this.welcome.bundled; ) {
      const size = view.getUint16(offset, true);
      bundled.push(bytes.slice(offset + 2, offset + 2 + size));
      offset += 2 + size;
    }
    if (bundled.length !== this.welcome.bundled || offset !== bytes.length)
      throw new Error("the init segment is damaged");
    return { head, bundled };
  }
}
