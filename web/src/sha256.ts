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

/** Returns a new hash; where node's is missing, `update` adds the blocks. */
export function newSha256(update = compress): Sha256 {
  const native = builtin<NodeCrypto>("crypto")?.createHash("sha256");
  if (native) return { update: (bytes) => native.update(bytes), hex: () => native.digest("hex") };
  const portable = new PortableSha256(update);
  return { update: (bytes) => portable.update(bytes), hex: () => hex(portable.digest()) };
}

/** Returns the SHA-256 of some bytes, hexadecimal. */
export function sha256(bytes: Uint8Array): string {
  const hash = newSha256();
  hash.update(bytes);
  return hash.hex();
}

/** Bytes of a block; also the number of rounds. */
export const BLOCK = 64;
/** Bytes of the message length at the end of the last block. */
const LENGTH_BYTES = 8;
const PRIMES: number[] = [];
for (let n = 2; PRIMES.length < BLOCK; n++) if (PRIMES.every((prime) => n % prime)) PRIMES.push(n);
/** First 32 bits of the fraction of a number. */
const fraction = (value: number): number => Math.floor((value % 1) * 2 ** 32);
/** Constants of the rounds. */
export const ROUNDS = Int32Array.from(PRIMES, (prime) => fraction(Math.cbrt(prime)));
const START = PRIMES.slice(0, 8).map((prime) => fraction(Math.sqrt(prime))),
  WORDS = new Int32Array(BLOCK);

const rotated = (word: number, bits: number): number => (word >>> bits) | (word << (32 - bits));

export class PortableSha256 {
  readonly #state = Int32Array.from(START);
  /** Bytes of an unfinished block. */
  readonly #block = new Uint8Array(BLOCK);
  readonly #view = new DataView(this.#block.buffer);
  #size = 0;

  /** `compress` updates the state with whole blocks. */
  constructor(readonly compress: (state: Int32Array, blocks: Uint8Array) => void) {}

  update(bytes: Uint8Array): void {
    const begin = this.#size % BLOCK,
      first = begin && Math.min(BLOCK - begin, bytes.length),
      end = bytes.length - ((begin + bytes.length) % BLOCK);
    this.#size += bytes.length;
    this.#block.set(bytes.subarray(0, first), begin);
    if (end < first) return;
    if (first) this.compress(this.#state, this.#block);
    this.compress(this.#state, bytes.subarray(first, end));
    this.#block.set(bytes.subarray(end));
  }

  digest(): Uint8Array {
    const bits = 8 * this.#size,
      used = this.#size % BLOCK,
      padding = new Uint8Array((used < BLOCK - LENGTH_BYTES ? BLOCK : 2 * BLOCK) - LENGTH_BYTES - used);
    padding[0] = 128;
    this.update(padding);
    this.#view.setUint32(BLOCK - LENGTH_BYTES, bits / 2 ** 32);
    this.#view.setUint32(BLOCK - LENGTH_BYTES / 2, bits);
    this.compress(this.#state, this.#block);
    const digest = new DataView(new ArrayBuffer(32));
    this.#state.forEach((word, n) => digest.setInt32(4 * n, word));
    return new Uint8Array(digest.buffer);
  }
}

/** Updates the state with whole blocks. */
export function compress(state: Int32Array, blocks: Uint8Array): void {
  const view = new DataView(blocks.buffer, blocks.byteOffset, blocks.length);
  for (let at = 0; at < blocks.length; at += BLOCK) compressOne(state, view, at);
}

/** Updates `state` with the block at `at`. Sums of two are 32-bit integers, longer ones doubles. */
function compressOne(state: Int32Array, view: DataView, at: number): void {
  let a = state[0],
    b = state[1],
    c = state[2],
    d = state[3],
    e = state[4],
    f = state[5],
    g = state[6],
    h = state[7];
  for (let t = 0; t < BLOCK; t++) {
    let word: number;
    if (t < 16) word = view.getInt32(at + 4 * t);
    else {
      const x = WORDS[t - 15],
        y = WORDS[t - 2];
      word = (WORDS[t - 16] + (rotated(x, 7) ^ rotated(x, 18) ^ (x >>> 3))) | 0;
      word = (word + ((WORDS[t - 7] + (rotated(y, 17) ^ rotated(y, 19) ^ (y >>> 10))) | 0)) | 0;
    }
    WORDS[t] = word;
    const own = (h + (rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25))) | 0,
      sum = (((own + (g ^ (e & (f ^ g)))) | 0) + ((ROUNDS[t] + word) | 0)) | 0,
      other = ((rotated(a, 2) ^ rotated(a, 13) ^ rotated(a, 22)) + ((a & b) | (c & (a | b)))) | 0;
    h = g;
    g = f;
    f = e;
    e = (d + sum) | 0;
    d = c;
    c = b;
    b = a;
    a = (sum + other) | 0;
  }
  [a, b, c, d, e, f, g, h].forEach((value, n) => (state[n] += value));
}
