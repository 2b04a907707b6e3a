// What of PlayCanvas the page has: a camera and Gaussians sorted in a worker, by WebGL. Lit surfaces, light and shadow,
// skies, WebGPU, headsets, levels of detail of its own and files of its own are left out.

import { readdirSync, readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

/** Texts of shaders: of Gaussians, and what those include. */
const SHADERS_LEFT_OUT =
  /shader-lib\/(wgsl\/chunks|glsl\/chunks\/(internal|lit|particle|skybox|sprite|standard))\/.*\.js$/;

/** Modules of which nothing is ever made here, by room. */
const MODULES = {
  "framework/handlers": ["untar"],
  "framework/parsers/glb": ["gltf-accessor", "extensions/khr-gaussian-splatting"],
  "platform/graphics": ["compute", "draw-commands", "storage-buffer"],
  "platform/graphics/webgl": ["webgl-draw-commands", "webgl-xr-bridge", "webgl-xr-msaa-copy"],
  "scene/graphics": ["env-lighting", "prefix-sum-kernel", "reproject-texture"],
  "scene/graphics/radix-sort": [
    "compute-radix-sort",
    "compute-radix-sort-base",
    "compute-radix-sort-multipass",
    "compute-radix-sort-onesweep",
  ],
  "scene/gsplat": ["gsplat-instance", "gsplat-resource", "gsplat-sort-worker", "gsplat-sorter"],
  "scene/gsplat-unified": [
    "gsplat-hybrid-renderer",
    "gsplat-interval-compaction",
    "gsplat-lod-table",
    "gsplat-octree",
    "gsplat-octree-instance",
    "gsplat-octree-node",
    "gsplat-octree.resource",
    "gsplat-projector",
    "gsplat-shadow-renderer",
  ],
  "scene/immediate": ["immediate-batch", "immediate-batches"],
  "scene/lighting": ["light-slot-uniforms", "world-clusters-debug"],
  "scene/materials": ["lit-material-options-builder"],
  "scene/renderer": [
    "frame-pass-multi-view",
    "render-pass-shadow-directional",
    "render-pass-shadow-local-non-clustered",
  ],
  "scene/shader-lib/programs": ["lit-shader"],
  "scene/skybox": ["sky-geometry", "sky-mesh"],
};
const named = Object.entries(MODULES).flatMap(([room, names]) =>
  names.map((name) => `${room}/${name}`.replace(".", "\\.")),
);
const MODULES_LEFT_OUT = new RegExp(`playcanvas/src/(${named.join("|")})\\.js$`);

const EXPORTS = /^export \{([^}]*)\};/m;

/** What a module exports, each of it the same thing. */
function instead(path, thing) {
  const names = readFileSync(path, "utf8").match(EXPORTS)[1].split(","),
    all = names.map((name) => `none as ${name.trim().split(" as ").pop()}`);
  return { contents: `${thing}\nexport { ${all.join(", ")} };` };
}

const FEW_BUCKETS = "Math.max(10, Math.min(20, Math.round(Math.log2(numVertices / 4))))";
/** Its 2^12 for 14,526 Gaussians, of which a view needs an eighth, draw many in a wrong order: 3 to 10 dB. */
const LEAST_BITS = 18;

/** As many buckets of depth as it takes to draw Gaussians in their order. */
export const finer = {
  name: "finer",
  setup(setup) {
    setup.onLoad({ filter: /gsplat-unified-sort-worker\.js$/ }, ({ path }) => {
      const text = readFileSync(path, "utf8");
      if (!text.includes(FEW_BUCKETS)) throw new Error("PlayCanvas counts its buckets in another way by now");
      return { contents: text.replace(FEW_BUCKETS, FEW_BUCKETS.replace("10", `${LEAST_BITS}`)), loader: "js" };
    });
  },
};

/** Leaves out what the page never reaches; whoever reaches it all the same is told so. */
export const smaller = {
  name: "smaller",
  setup(setup) {
    finer.setup(setup);
    setup.onLoad({ filter: SHADERS_LEFT_OUT }, ({ path }) => instead(path, 'const none = "";'));
    setup.onLoad({ filter: MODULES_LEFT_OUT }, ({ path }) =>
      instead(path, 'class none { constructor() { throw new Error("left out of PlayCanvas: scripts/engine.mjs"); } }'),
    );
  },
};

/** The entry point whose modules are the engine's lower half: what draws, without the scene and its components. */
export const LOWER = "lower-half";
const SCENE = "./node_modules/playcanvas/build/playcanvas/src/scene/";
const LOWER_HALF = ["renderer/forward-renderer", "materials/standard-material", "gsplat-unified/gsplat-manager"];

/** No module of PlayCanvas refers to those that refer to it: where that entry is, too, what both need is a chunk. */
export const lower = {
  name: "lower",
  setup(setup) {
    setup.onResolve({ filter: new RegExp(`^${LOWER}$`) }, ({ path }) => ({ path, namespace: "lower" }));
    setup.onLoad({ filter: /.*/, namespace: "lower" }, () => ({
      contents: LOWER_HALF.map((name) => `export * from "${SCENE}${name}.js";`).join("\n"),
      resolveDir: fileURLToPath(new URL("..", import.meta.url)),
    }));
  },
};

/** Sources of what draws: the first script waits for none of them. */
const DRAWING = /render\/(view|tiled|container|precise)\.ts$/;
const METHOD = /^\t(?:static )?(\w+)\([^\n]*\) \{\n(?:\t\t[^\n]*\n|\n)*\t\},?\n/gm;

const MATH = fileURLToPath(new URL("../node_modules/playcanvas/build/playcanvas/src/core/math/", import.meta.url));

/** Of PlayCanvas's vectors the first script has the methods whose names occur in its sources, and what those call. */
export const vectors = {
  name: "vectors",
  setup(setup) {
    const src = fileURLToPath(new URL("../src/", import.meta.url)),
      ours = readdirSync(src, { recursive: true }).filter((name) => name.endsWith(".ts") && !DRAWING.test(name)),
      files = ["math", "quat", "vec3"].map((name) => readFileSync(`${MATH}${name}.js`, "utf8")),
      methods = files.flatMap((text) => [...text.matchAll(METHOD)]),
      asked = new Set(["constructor"]);
    const ask = (text) => {
      for (const [, name] of text.matchAll(/\.(\w+)\(/g)) {
        if (asked.has(name)) continue;
        asked.add(name);
        for (const [body, other] of methods) if (other === name) ask(body);
      }
    };
    for (const name of ours) ask(readFileSync(src + name, "utf8"));
    for (const text of files) ask(text.replace(METHOD, ""));
    for (const [body, name] of methods) if (name === "constructor") ask(body);
    setup.onLoad({ filter: /core\/math\/(math|quat|vec3)\.js$/ }, ({ path }) => {
      const contents = readFileSync(path, "utf8").replace(METHOD, (body, name) => (asked.has(name) ? body : ""));
      return { contents, loader: "js" };
    });
  },
};
