// SHA-256 (FIPS 180-4) of data in pieces: node's, which is much faster, or a portable one.

import { hex } from "./bytes.ts";
import { builtin } from "./node.ts";

interface NodeCrypto {
  createHash(name: "sha256"): { update(bytes: Uint8Array): void; digest(encoding: "hex"): string };
}

/** Hash of the bytes that were added so far. */
export interface Sha256 {
  update(bytes: Uint8Array): void;
  /** Returns the digest, hexadecimal. No bytes can be added afterwards. */
  hex(): string;
}

export function newSha256(): Sha256 {
  const native = builtin<NodeCrypto>("crypto")?.createHash("sha256");
  if (native) return { update: (bytes) => native.update(bytes), hex: () => native.digest("hex") };
  const portable = new PortableSha256();
  return { update: (bytes) => portable.update(bytes), hex: () => hex(portable.digest()) };
}

/** Returns the SHA-256 of some bytes, hexadecimal. */
export function sha256(bytes: Uint8Array): string {
  const hash = newSha256();
  hash.update(bytes);
  return hash.hex();
}

const BLOCK = 64,
  /** Bytes of the message length at the end of the last block. */
  LENGTH_BYTES = 8;
const PRIMES: number[] = [];
for (let n = 2; PRIMES.length < BLOCK; n++) if (PRIMES.every((prime) => n % prime)) PRIMES.push(n);
/** First 32 bits of the fraction of a number. */
const fraction = (value: number): number => Math.floor((value % 1) * 2 ** 32);
const ROUNDS = Int32Array.from(PRIMES, (prime) => fraction(Math.cbrt(prime))),
  START = PRIMES.slice(0, 8).map((prime) => fraction(Math.sqrt(prime))),
  WORDS = new Int32Array(BLOCK);

const rotated = (word: number, bits: number): number => (word >>> bits) | (word << (32 - bits));

export class PortableSha256 {
  readonly #state = Int32Array.from(START);
  readonly #block = new Uint8Array(BLOCK);
  readonly #view = new DataView(this.#block.buffer);
  #size = 0;

  update(bytes: Uint8Array): void {
    for (let at = 0; at < bytes.length; ) {
      const begin = this.#size % BLOCK,
        count = Math.min(BLOCK - begin, bytes.length - at);
      this.#block.set(bytes.subarray(at, at + count), begin);
      this.#size += count;
      at += count;
      if (begin + count === BLOCK) this.#compress();
    }
  }

  digest(): Uint8Array {
    const bits = 8 * this.#size,
      used = this.#size % BLOCK,
      padding = new Uint8Array((used < BLOCK - LENGTH_BYTES ? BLOCK : 2 * BLOCK) - LENGTH_BYTES - used);
    padding[0] = 128;
    this.update(padding);
    this.#view.setUint32(BLOCK - LENGTH_BYTES, bits / 2 ** 32);
    this.#view.setUint32(BLOCK - LENGTH_BYTES / 2, bits);
    this.#compress();
    const digest = new DataView(new ArrayBuffer(32));
    this.#state.forEach((word, n) => digest.setInt32(4 * n, word));
    return new Uint8Array(digest.buffer);
  }

  #compress(): void {
    const state = this.#state;
    for (let t = 0; t < BLOCK; t++) {
      if (t < 16) {
        WORDS[t] = this.#view.getInt32(4 * t);
        continue;
      }
      const x = WORDS[t - 15],
        y = WORDS[t - 2];
      WORDS[t] =
        WORDS[t - 16] +
        (rotated(x, 7) ^ rotated(x, 18) ^ (x >>> 3)) +
        WORDS[t - 7] +
        (rotated(y, 17) ^ rotated(y, 19) ^ (y >>> 10));
    }
    let [a, b, c, d, e, f, g, h] = state;
    for (let t = 0; t < BLOCK; t++) {
      const sum =
          (h + (rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25)) + ((e & f) ^ (~e & g)) + ROUNDS[t] + WORDS[t]) | 0,
        other = ((rotated(a, 2) ^ rotated(a, 13) ^ rotated(a, 22)) + ((a & b) ^ (a & c) ^ (b & c))) | 0;
      h = g;
      g = f;
      f = e;
      e = (d + sum) | 0;
      d = c;
      c = b;
      b = a;
      a = (sum + other) | 0;
    }
    [a, b, c, d, e, f, g, h].forEach((word, n) => (state[n] += word));
  }
}
