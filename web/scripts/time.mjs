// node scripts/time.mjs STREAM: processor time of decoding a Gaussian in this thread, microseconds; the best of three passes.

import { build } from "esbuild";
import { writeFileSync, mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const root = fileURLToPath(new URL("..", import.meta.url)), out = mkdtempSync(join(tmpdir(), "splatwire-web-"));
try {
  const made = await build({ absWorkingDir: root, entryPoints: ["test/time.ts"], bundle: true, platform: "node", format: "esm", write: false, logLevel: "error" });
  writeFileSync(join(out, "time.mjs"), made.outputFiles[0].text);
  const { decodeTime } = await import(pathToFileURL(join(out, "time.mjs")).href);
  console.log(Math.min(...[0, 1, 2].map(() => decodeTime(process.argv[2]))).toFixed(2));
} finally {
  rmSync(out, { recursive: true });
}
