// SHA-256 of data in pieces: node's, which is much faster, or a portable one.

import { sha256 } from "@noble/hashes/sha2.js";

import { hex } from "./bytes.ts";

interface NodeHash {
  update(bytes: Uint8Array): void;
  digest(encoding: "hex"): string;
}

interface NodeProcess {
  getBuiltinModule?(name: "node:crypto"): { createHash(name: "sha256"): NodeHash } | undefined;
}

/** Hash of the bytes that were added so far. */
export interface Sha256 {
  update(bytes: Uint8Array): void;
  /** Returns the digest, hexadecimal. No bytes can be added afterwards. */
  hex(): string;
}

export function newSha256(): Sha256 {
  const { process } = globalThis as { process?: NodeProcess },
    native = process?.getBuiltinModule?.("node:crypto")?.createHash("sha256");
  if (native) return { update: (bytes) => native.update(bytes), hex: () => native.digest("hex") };
  const portable = sha256.create();
  return { update: (bytes) => void portable.update(bytes), hex: () => hex(portable.digest()) };
}
