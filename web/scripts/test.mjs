// npm test: bundles the tests for node and runs them; `only NAME` runs one of them. `npm run fuzz -- STREAM...` runs
// 100,000 hostile cases. STREAMS lists streams to decode, separated by ':'. EXPECTED is a file with answers of Python
// (tests/transport/web_answers.py).

import { spawnSync } from "node:child_process";
import { mkdtempSync, readdirSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url)),
  fuzz = process.argv[2] === "fuzz",
  only = process.argv[2] === "only" ? process.argv[3] : null,
  out = mkdtempSync(join(tmpdir(), "splatwire-web-"));
try {
  // Need inputs from Python: ANSWERS (tests/web/test_agreement.py), GREEDY (tests/web/test_memory.py),
  // UPDATES (tests/web/test_updates.py)
  const apart = ["agreement.test.ts", "memory.test.ts", "updates.test.ts"];
  const wanted = (name) =>
    only ? name === `${only}.test.ts` : fuzz ? name === "hostile.test.ts" : !apart.includes(name);
  const names = readdirSync(join(root, "test")).filter((name) => name.endsWith(".test.ts") && wanted(name));
  await build({
    absWorkingDir: root,
    // a folder for each test: load.test.ts writes files next to its bundle
    entryPoints: names.map((name) => ({ in: `test/${name}`, out: join(name, name.slice(0, -3)) })),
    bundle: true,
    platform: "node",
    alias: { "worker:receiver": join(root, "test", "fake_worker.ts") },
    define: { BUILD: '""', SEPARATE: "true" },
    format: "esm",
    outdir: out,
    outExtension: { ".js": ".mjs" },
    sourcemap: "inline",
    logLevel: "error",
  });
  const env = { ...process.env, ...(fuzz ? { CASES: "100000", STREAMS: process.argv.slice(3).join(":") } : {}) };
  const files = names.map((name) => join(out, name, `${name.slice(0, -3)}.mjs`));
  const done = spawnSync(process.execPath, ["--enable-source-maps", "--test", "--test-reporter=spec", ...files], {
    stdio: "inherit",
    env,
  });
  process.exitCode = done.status ?? 1;
} finally {
  rmSync(out, { recursive: true });
}
