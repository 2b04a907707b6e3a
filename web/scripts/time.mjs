// node scripts/time.mjs STREAM: processor time of decoding an element, and of one view of it, in this thread,
// microseconds; the best of three passes. Of a clip: processor time of a frame that is played for the first time,
// milliseconds; three passes, each with a decoder of its own.

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
