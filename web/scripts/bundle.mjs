// How bundles are made. Workers start out of text that is a part of the page's script (one file is all that a page
// loads), or, for pages whose policy forbids `blob:`, out of files beside it.

import { readFileSync } from "node:fs";
import { basename, dirname } from "node:path";
import { fileURLToPath } from "node:url";

import { build, transform } from "esbuild";
import { minify } from "terser";

import { finer, LOWER, lower, smaller, vectors } from "./engine.mjs";

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
  tsconfigRaw: { compilerOptions: { useDefineForClassFields: false } }, // no field is named twice
  logLevel: "error",
};
const banner = {
  js: `/* splatwire ${version} web receiver, Apache-2.0; with PlayCanvas (MIT) and @noble/hashes (MIT) */`,
};

/** Text of the receiver's worker. */
async function receiver() {
  const made = await build({ ...common, entryPoints: ["src/worker.ts"], format: "iife" });
  // 6 % fewer compressed bytes than esbuild alone
  return (await minify(made.outputFiles[0].text, { ecma: 2022, compress: { passes: 2 }, mangle: { toplevel: true } }))
    .code;
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

/** The element's style sheet without what only its readers need. */
const looks = {
  name: "looks",
  setup(setup) {
    setup.onLoad({ filter: /page\/style\.ts$/ }, async ({ path }) => {
      const [, sheet] = readFileSync(path, "utf8").match(/`([^`]*)`/),
        { code } = await transform(sheet, { loader: "css", minify: true });
      return { contents: `export const STYLE = ${JSON.stringify(code)};`, loader: "js" };
    });
  },
};

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
  const make = async (name, entry, less) => {
    const plugins = [worker(strict), ...less];
    const made = await build({
      ...common,
      entryPoints: { [name]: entry },
      outdir: ".",
      format: "esm",
      plugins,
      banner,
    });
    return [`${name}.js`, made.outputFiles[0].text];
  };
  return [
    await make("splatwire", "src/main.ts", [vectors, looks]),
    await make("splatwire-view", "src/view.ts", [smaller]),
  ];
}

const SORTING = "node_modules/playcanvas/build/playcanvas/src/scene/gsplat-unified";
/** What PlayCanvas's sorter runs as text, as a file. */
const SORTER = `
  import { GSplatSortBinWeights } from "./${SORTING}/gsplat-sort-bin-weights.js";
  import { UnifiedSortWorker } from "./${SORTING}/gsplat-unified-sort-worker.js";
  globalThis.GSplatSortBinWeights = GSplatSortBinWeights;
  UnifiedSortWorker(self);`;

/** In a package what draws is two modules that bundlers see, each of them small enough for a chunk of its own. */
const drawing = (engine, view) => ({
  name: "drawing",
  setup(setup) {
    setup.onResolve({ filter: /^drawing:/ }, ({ path }) => ({ path: path.slice(8), external: true }));
    setup.onLoad({ filter: /render\/load\.ts$/ }, () => ({
      contents: `export async function loadView() {
        const [{ View }] = await Promise.all([import("drawing:${view}"), import("drawing:${engine}")]);
        return View;
      }`,
      loader: "js",
    }));
  },
});

/** Doors of other programs: their packages and our decoder stay modules of their own. */
const decoderAlone = {
  name: "decoder",
  setup(setup) {
    setup.onResolve({ filter: /\/decoder\.ts$/ }, () => ({ path: "./decoder.js", external: true }));
  },
};
const DOORS = { playcanvas: "src/doors/playcanvas.ts", three: "src/doors/three.ts" },
  THEIRS = ["playcanvas", "three", "@sparkjsdev/spark", "node:*"];

/** Files of the npm package by name: modules with their source maps, and workers for pages without `blob:`. */
export async function modules() {
  const found = [];
  const make = async (entryPoints, more) => {
    // node prints the line of an error that nobody catches
    const files = { sourcemap: true, lineLimit: 1000 };
    const made = await build({ ...common, entryPoints, outdir: ".", ...files, banner, ...more });
    for (const { path, contents } of made.outputFiles)
      if (!basename(path).startsWith(LOWER)) found.push([basename(path), contents]);
  };
  const esm = { format: "esm" };
  await make({ decoder: "src/decoder.ts" }, esm);
  const element = async (name, view, engine, strict) => {
    const plugins = [worker(strict), vectors, looks, drawing(`./${engine}.js`, `./${view}.js`)];
    await make({ [name]: "src/index.ts" }, { ...esm, plugins });
    const parts = { ...esm, plugins: [worker(strict), smaller, lower], splitting: true, chunkNames: engine };
    await make({ [view]: "src/render/view.ts", [LOWER]: LOWER }, parts);
  };
  await element("index", "view", "engine", false);
  await element("strict", "strict-view", "strict-engine", true);
  const doors = { ...esm, external: THEIRS, plugins: [decoderAlone] };
  await make(DOORS, doors);
  const generator = { "splat-transform": "src/doors/splat_transform.ts" };
  await make(generator, { ...doors, outExtension: { ".js": ".mjs" } });
  await make({ "splatwire-worker": "src/worker.ts" }, { format: "iife" });
  const stdin = { contents: SORTER, resolveDir: root, sourcefile: "splatwire-sorter.js" };
  await make(undefined, { format: "iife", plugins: [finer], stdin, outfile: "splatwire-sorter.js", outdir: undefined });
  return found;
}
