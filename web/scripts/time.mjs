// node scripts/time.mjs STREAM: processor times in this thread, best of three passes. Scenes: microseconds per element
// for decoding and for one view. Clips: milliseconds per frame of a first playback.

import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url)),
  out = mkdtempSync(join(tmpdir(), "splatwire-web-"));
try {
  const made = await build({
    absWorkingDir: root,
    entryPoints: ["test/time.ts"],
    bundle: true,
    platform: "node",
    format: "esm",
    write: false,
    logLevel: "error",
  });
  writeFileSync(join(out, "time.mjs"), made.outputFiles[0].text);
  const { clipTimes, passTimes } = await import(pathToFileURL(join(out, "time.mjs")).href);
  const passes = [0, 1, 2].map(() => clipTimes(process.argv[2]) ?? passTimes(process.argv[2])),
    best = (name) => [name, Math.min(...passes.map((pass) => pass[name]))];
  console.log(JSON.stringify(Object.fromEntries(Object.keys(passes[0]).map(best))));
} finally {
  rmSync(out, { recursive: true });
}
