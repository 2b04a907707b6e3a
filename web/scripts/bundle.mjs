// How bundles are made. Workers start out of text that is a part of the page's script (one file is all that a page
// loads), or, for pages whose policy forbids `blob:`, out of files beside it.

import { readFileSync } from "node:fs";
import { basename, dirname } from "node:path";
import { fileURLToPath } from "node:url";

import { build } from "esbuild";

const root = fileURLToPath(new URL("..", import.meta.url));
export const { version } = JSON.parse(readFileSync(`${root}package.json`, "utf8"));
const common = {
  bundle: true,
  minify: true,
  charset: "utf8",
  target: "es2022",
  absWorkingDir: root,
  write: false,
  legalComments: "none",
  logLevel: "error",
};
const banner = {
  js: `/* splatwire ${version} web receiver, Apache-2.0; with PlayCanvas (MIT) and @noble/hashes (MIT) */`,
};

/** Text of the receiver's worker. */
async function receiver() {
  const made = await build({ ...common, entryPoints: ["src/worker.ts"], format: "iife" });
  return made.outputFiles[0].text;
}

/** A function that starts the receiver: of its text one address is made for the whole page. */
const fromText = async () => `
  const text = ${JSON.stringify(await receiver())};
  let url;
  export default () => new Worker((url ??= URL.createObjectURL(new Blob([text], { type: "text/javascript" }))));`;
const fromFile = () => `
  export default () => new Worker(new URL("./splatwire-worker.js", import.meta.url));`;

const worker = (strict) => ({
  name: "worker",
  setup(setup) {
    setup.onResolve({ filter: /^worker:/ }, ({ path }) => ({ path, namespace: "worker" }));
    setup.onLoad({ filter: /.*/, namespace: "worker" }, async () => ({
      contents: strict ? fromFile() : await fromText(),
      loader: "js",
    }));
    setup.onLoad({ filter: /gsplat-unified-sorter\.js$/ }, ({ path }) => sorter(path, strict));
  },
});

const BLOB = /URL\.createObjectURL\(new Blob\(\[workerSource\], \{\s*type: "application\/javascript"\s*\}\)\)/;

/** PlayCanvas makes a new address for each application and gives none back; here it is one for the page, or a file. */
function sorter(path, strict) {
  const text = readFileSync(path, "utf8");
  if (!BLOB.test(text)) throw new Error("PlayCanvas starts its sorter in another way by now: scripts/bundle.mjs");
  const made = text.match(BLOB)[0],
    address = strict ? 'new URL("./splatwire-sorter.js", import.meta.url)' : `(sorterUrl ??= ${made})`;
  const contents = `let sorterUrl;\n${text.replace(BLOB, address)}`;
  return { contents, loader: "js", resolveDir: dirname(path) };
}

/** Text of each bundle of the page by its name, the same for the same sources and the packages of the lock file. */
export async function bundles(strict = false) {
  const entryPoints = { splatwire: "src/main.ts", "splatwire-view": "src/view.ts" };
  const made = await build({ ...common, entryPoints, outdir: ".", format: "esm", plugins: [worker(strict)], banner });
  return made.outputFiles.map(({ path, text }) => [basename(path), text]);
}
