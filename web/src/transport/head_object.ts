// The head object of a stream while its symbols come: manifest, side information, and the packets behind them.

import { sha256 } from "@noble/hashes/sha2.js";

import { hex } from "../bytes.ts";
import { checkHead, fileHead, type Head } from "../packets/container.ts";
import { readManifest } from "../packets/manifest.ts";
import { viewOf, type Welcome } from "./frames.ts";

const SEGMENT_SYMBOLS = 2048;

export class HeadObject {
  readonly numSymbols: number;
  readonly #object: Uint8Array;
  readonly #seen: Uint8Array;
  #count = 0;

  constructor(readonly welcome: Welcome) {
    this.numSymbols = Math.ceil(welcome.headBytes / welcome.symbolBytes);
    this.#object = new Uint8Array(welcome.headBytes);
    this.#seen = new Uint8Array(this.numSymbols);
  }

  /** Symbols that are not there. */
  get missing(): number {
    return this.numSymbols - this.#count;
  }

  /** The stream's file up to its first packet; once all came. */
  file(head: Head): Uint8Array {
    const size = viewOf(this.#object).getUint32(0, true);
    return fileHead(this.#object.subarray(4, 4 + size), head.sideInfo);
  }

  /** SHA-256 of what came, hexadecimal. */
  get digest(): string {
    return hex(sha256(this.#object));
  }

  /** Takes a symbol; false for one that does not fit. */
  add(bytes: Uint8Array): boolean {
    const { symbolBytes, headBytes } = this.welcome,
      numbers = viewOf(bytes),
      segments = Math.ceil(this.numSymbols / SEGMENT_SYMBOLS),
      segment = numbers.getUint16(9, true),
      payload = bytes.subarray(15, bytes.length - 4),
      at = Math.floor((this.numSymbols * segment) / segments) + numbers.getUint32(11, true),
      next = Math.floor((this.numSymbols * (segment + 1)) / segments);
    if (segment >= segments || at >= next || payload.length !== symbolBytes) return false;
    if (this.#seen[at]) return true; // once more, another way
    this.#object.set(payload.subarray(0, Math.min(symbolBytes, headBytes - at * symbolBytes)), at * symbolBytes);
    this.#seen[at] = 1;
    this.#count++;
    return true;
  }

  /** Manifest and side information, and the packets that travel behind them. Throws where they are damaged. */
  read(): { head: Head; carried: Uint8Array[] } {
    const object = this.#object,
      numbers = viewOf(object),
      carried: Uint8Array[] = [];
    if (this.digest !== hex(this.welcome.digest)) throw new Error("the side information is damaged");
    const manifestEnd = 4 + (object.length >= 4 ? numbers.getUint32(0, true) : 0),
      manifest = readManifest(object.subarray(4, manifestEnd));
    let at = manifestEnd + manifest.sideInfoBytes;
    const head = checkHead(manifest, object.subarray(manifestEnd, at));
    for (; at + 2 <= object.length && carried.length < this.welcome.carried; ) {
      const size = numbers.getUint16(at, true);
      carried.push(object.slice(at + 2, at + 2 + size));
      at += 2 + size;
    }
    if (carried.length !== this.welcome.carried || at !== object.length)
      throw new Error("the side information is damaged");
    return { head, carried };
  }
}
