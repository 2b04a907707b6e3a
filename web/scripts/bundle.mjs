// How the bundle is made: the worker first, whose text is then a part of it.

import { readFileSync } from "node:fs";
import { basename } from "node:path";
import { fileURLToPath } from "node:url";

import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url));
const { version } = JSON.parse(readFileSync(`${root}package.json`, "utf8"));
const common = {
  bundle: true,
  minify: true,
  charset: "utf8",
  target: "es2022",
  absWorkingDir: root,
  write: false,
  legalComments: "none",
};

const worker = {
  name: "worker",
  setup(setup) {
    setup.onResolve({ filter: /^worker:/ }, ({ path }) => ({ path, namespace: "worker" }));
    setup.onLoad({ filter: /.*/, namespace: "worker" }, async () => {
      const made = await build({ ...common, entryPoints: ["src/worker.ts"], format: "iife" });
      return { contents: made.outputFiles[0].text, loader: "text" };
    });
  },
};

/** Text of each bundle by its name, the same for the same sources and the packages of the lock file. */
export async function bundles() {
  const banner = {
    js: `/* splatwire ${version} web receiver, Apache-2.0; with PlayCanvas (MIT) and @noble/hashes (MIT) */`,
  };
  const entryPoints = { splatwire: "src/main.ts", "splatwire-view": "src/view.ts" };
  const made = await build({
    ...common,
    entryPoints,
    outdir: ".",
    format: "esm",
    plugins: [worker],
    banner,
    logLevel: "error",
  });
  return made.outputFiles.map(({ path, text }) => [basename(path), text]);
}
