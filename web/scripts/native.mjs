// npm run native: compiles `native/gaussians.c` to WebAssembly with the clang of the Python package `ziglang` 0.17.1
// and writes it as text into a module. The module is committed, so that only changes of the C file need the compiler.

import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const root = fileURLToPath(new URL("..", import.meta.url)),
  source = join(root, "native/gaussians.c"),
  out = mkdtempSync(join(tmpdir(), "splatwire-native-"));
/** Tables that the decoder's caller fills. */
const tables =
  "normal inverses widths thinness coefficients bases scales initial defaults fractions wholes transform corner".split(
    " ",
  );
try {
  const binary = join(out, "gaussians.wasm");
  execFileSync(
    process.env["PYTHON"] ?? "python3",
    [
      ...["-m", "ziglang", "cc", "-target", "wasm32-freestanding", "-nostdlib", "-Wl,--no-entry", "-Wl,--strip-all"],
      ...["-mcpu=generic+simd128+nontrapping_fptoint+bulk_memory", "-Os"],
      ...tables.map((name) => `-Wl,--export=${name}`),
      ...["-o", binary, source],
    ],
    { stdio: "inherit" },
  );
  // As hexadecimal digits, which compress better than base64 because bytes stay aligned.
  const lines = readFileSync(binary)
      .toString("hex")
      .match(/.{1,108}/g),
    digest = createHash("sha256").update(readFileSync(source)).digest("hex");
  writeFileSync(
    join(root, "src/codec/gaussians/native_module.ts"),
    `// Written by \`npm run native\` from \`native/gaussians.c\`.

/** SHA-256 of the source. */
export const SOURCE_DIGEST = "${digest}";
/** Module in WebAssembly, hexadecimal. */
export const MODULE =
  ${lines.map((line) => `"${line}"`).join(" +\n  ")};
`,
  );
} finally {
  rmSync(out, { recursive: true });
}
