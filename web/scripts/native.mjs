// npm run native: compiles `native/gaussians.c` to WebAssembly with the clang of the Python package `ziglang` 0.17.1,
// optimises it with `wasm-opt` of the npm package `binaryen` 132.0.0 and writes it as text into a module. The module
// is committed, so that only changes of the C file and of this script need the tools. They give the same bytes every
// time.

import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const script = fileURLToPath(import.meta.url),
  root = fileURLToPath(new URL("..", import.meta.url)),
  source = join(root, "native/gaussians.c"),
  python = process.env["PYTHON"] ?? "python3",
  out = mkdtempSync(join(tmpdir(), "splatwire-native-"));
/** Version of `ziglang`; others give other bytes. */
const ZIG = "0.17.1";
/** Constants of the text that `src/codec/gaussians/native.ts` reads. This offset gives the fewest compressed bytes. */
const OFFSET = 45,
  PREFIXES = "!#%&}~",
  EXCLUDED = `${PREFIXES}"'\`\\$`;
/** Tables that the decoder's caller fills. */
const tables = [
  ..."normal_cdf inverse_scales widths coefficients constant_terms scale_indices initial_models".split(" "),
  ..."block_means fractions wholes transform corner motion".split(" "),
];
try {
  const binary = join(out, "gaussians.wasm");
  const found = execFileSync(python, ["-m", "ziglang", "version"]).toString().trim();
  if (found !== ZIG) throw new Error(`ziglang ${ZIG} is needed, found ${found}`);
  execFileSync(
    python,
    [
      ...["-m", "ziglang", "cc", "-target", "wasm32-freestanding", "-nostdlib", "-Wl,--no-entry", "-Wl,--strip-all"],
      ...["-mcpu=generic+simd128+nontrapping_fptoint+bulk_memory", "-Os"],
      // fewer bytes, as fast
      ...["-fno-vectorize", "-fno-slp-vectorize", "-mllvm", "-inline-threshold=0", "-mllvm", "-disable-lsr"],
      ...tables.map((name) => `-Wl,--export=${name}`),
      ...["-o", binary, source],
    ],
    { stdio: "inherit" },
  );
  execFileSync(
    "npx",
    [
      ...["--yes", "--package=binaryen@132.0.0", "wasm-opt"],
      ...["simd", "nontrapping-float-to-int", "bulk-memory"].map((feature) => `--enable-${feature}`),
      ...["-O3", "--converge", "--zero-filled-memory", "--reorder-functions", "-o", binary, binary],
    ],
    { stdio: "inherit" },
  );
  // Most bytes take one character, others two. This compresses better than hexadecimal digits or base64.
  const characters = [...readFileSync(binary)].map((byte) => {
      const code = (byte + OFFSET) & 255,
        character = String.fromCharCode(code);
      if (code >= 32 && code < 127 && !EXCLUDED.includes(character)) return character;
      return PREFIXES[Math.floor(code / 48)] + String.fromCharCode(40 + (code % 48));
    }),
    lines = characters.join("").match(/.{1,108}/g),
    digest = createHash("sha256"); // also of this script, which has the options and the versions of the tools
  for (const path of [source, script]) digest.update(readFileSync(path));
  writeFileSync(
    join(root, "src/codec/gaussians/native_module.ts"),
    `// Written by \`npm run native\` from \`native/gaussians.c\`.

/** SHA-256 of the source and of the script, one after the other. */
export const SOURCE_DIGEST = "${digest.digest("hex")}";
/** Module in WebAssembly, as text. */
export const MODULE =
  ${lines.map((line) => `"${line}"`).join(" +\n  ")};
`,
  );
} finally {
  rmSync(out, { recursive: true });
}
