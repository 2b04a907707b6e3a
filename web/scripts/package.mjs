// node scripts/package.mjs FOLDER: writes the npm package `splatwire`.

import { spawnSync } from "node:child_process";
import { appendFileSync, copyFileSync, mkdirSync, readdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

import { modules, version } from "./bundle.mjs";

const root = fileURLToPath(new URL("..", import.meta.url)),
  out = process.argv[2];
rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });

for (const [name, bytes] of await modules()) writeFileSync(join(out, name), bytes);

// Type declarations of the exports and of everything they refer to.
const tsc = join(root, "node_modules", ".bin", "tsc"),
  options = ["-p", join(root, "tsconfig.package.json"), "--outDir", join(out, "types")],
  made = spawnSync(tsc, options, { encoding: "utf8" });
if (made.status !== 0) throw new Error(made.stdout + made.stderr);
const reached = new Set();
const IMPORT = /(from "|import\(")(\.[^"]*)\.ts"/g;
const reach = (name) => {
  if (reached.has(name)) return;
  reached.add(name);
  const path = join(out, "types", name),
    text = readFileSync(path, "utf8");
  for (const [, , target] of text.matchAll(IMPORT)) reach(join(dirname(name), `${target}.d.ts`));
  // Before TypeScript 5.7, typed arrays have no type parameter.
  writeFileSync(path, text.replace(IMPORT, '$1$2.js"').replace(/Array<ArrayBuffer(Like)?>/g, "Array"));
};
// Handwritten types for frameworks. They refer to packages that are not installed here.
for (const name of ["frameworks.d.ts", "react.d.ts"]) copyFileSync(join(root, "types", name), join(out, "types", name));
appendFileSync(join(out, "types", "index.d.ts"), 'import "./frameworks.js";\n');
for (const name of [
  "index.d.ts",
  "frameworks.d.ts",
  "react.d.ts",
  "decoder.d.ts",
  "clip.d.ts",
  "integrations/babylon.d.ts",
  "integrations/playcanvas.d.ts",
  "integrations/three.d.ts",
  "integrations/three_core.d.ts",
])
  reach(name);
for (const name of readdirSync(join(out, "types"), { recursive: true }))
  if (name.endsWith(".d.ts") && !reached.has(name)) rmSync(join(out, "types", name));

const INTEGRATIONS = {
    playcanvas: "^2.21.0",
    three: ">=0.180.0",
    "@sparkjsdev/spark": "^2.2.0",
    "@babylonjs/core": ">=9.0.0",
    react: ">=18",
  },
  FRAMEWORKS = ["@types/react", "preact", "solid-js", "svelte", "vue"],
  PEERS = { ...INTEGRATIONS, ...Object.fromEntries(FRAMEWORKS.map((name) => [name, "*"])) };
const packaged = {
  name: "splatwire",
  version,
  description: "3D Gaussian splats across lossy networks: a viewer element, and a decoder",
  license: "Apache-2.0",
  type: "module",
  main: "./index.js",
  types: "./types/index.d.ts",
  exports: {
    ".": { types: "./types/index.d.ts", default: "./index.js" },
    "./strict": { types: "./types/index.d.ts", default: "./strict.js" },
    "./decoder": { types: "./types/decoder.d.ts", default: "./decoder.js" },
    "./clip": { types: "./types/clip.d.ts", default: "./clip.js" },
    "./playcanvas": { types: "./types/integrations/playcanvas.d.ts", default: "./playcanvas.js" },
    "./three": { types: "./types/integrations/three.d.ts", default: "./three.js" },
    "./three-core": { types: "./types/integrations/three_core.d.ts", default: "./three-core.js" },
    "./babylon": { types: "./types/integrations/babylon.d.ts", default: "./babylon.js" },
    "./react": { types: "./types/react.d.ts", default: "./react.js" },
    "./splat-transform.mjs": "./splat-transform.mjs",
    "./package.json": "./package.json",
  },
  // for the integrations and the frameworks' element types; the element and the decoder need none
  peerDependencies: PEERS,
  peerDependenciesMeta: Object.fromEntries(Object.keys(PEERS).map((name) => [name, { optional: true }])),
  sideEffects: ["./index.js", "./strict.js"],
  keywords: ["gaussian-splatting", "3dgs", "streaming", "webtransport", "web-component", "codec"],
};
writeFileSync(join(out, "package.json"), `${JSON.stringify(packaged, null, 2)}\n`);
copyFileSync(join(root, "PACKAGE.md"), join(out, "README.md"));
copyFileSync(join(root, "..", "LICENSE"), join(out, "LICENSE"));
copyFileSync(join(root, "../src/splatwire/web/LICENSES.txt"), join(out, "LICENSES.txt"));
console.log(`${out}: splatwire ${version}`);
