// Reduces PlayCanvas to a camera and Gaussians sorted in a worker, with WebGL. Removes lights, shadows, skies, WebGPU,
// augmented reality, and PlayCanvas's own levels of detail and file formats.

import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

/** Shader texts that are not needed for Gaussians. */
const SHADERS_LEFT_OUT =
  /shader-lib\/(wgsl\/chunks|glsl\/chunks\/(internal|lit|particle|skybox|sprite|standard))\/.*\.js$/;

/** Modules that are never instantiated here, by folder. */
const MODULES = {
  "framework/handlers": ["untar"],
  "framework/parsers/glb": ["gltf-accessor", "extensions/khr-gaussian-splatting"],
  "platform/graphics": ["compute", "draw-commands", "storage-buffer"],
  "platform/graphics/webgl": ["webgl-draw-commands", "webgl-xr-msaa-copy"],
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

/** Parts of WebXR sessions for augmented reality and controllers. They are instantiated but do nothing here. */
const XR_PARTS = "anchors|dom-overlay|hit-test|image-tracking|input|light-estimation|mesh-detection|plane-detection",
  XR_LEFT_OUT = new RegExp(`framework/xr/xr-(${XR_PARTS})\\.js$`);

const EXPORTS = /^export \{([^}]*)\};/m;

/** Replaces every export of a module by the same value. */
function instead(path, thing) {
  const names = readFileSync(path, "utf8").match(EXPORTS)[1].split(","),
    all = names.map((name) => `none as ${name.trim().split(" as ").pop()}`);
  return { contents: `${thing}\nexport { ${all.join(", ")} };` };
}

const FEW_BUCKETS = "Math.max(10, Math.min(20, Math.round(Math.log2(numVertices / 4))))";
/**
 * Least number of sorting bits. PlayCanvas's 2^12 buckets for 14,526 Gaussians cost 3 to 10 dB because many are drawn
 * in the wrong order.
 */
const MIN_BITS = 18;

/** Increases the number of depth buckets, so that Gaussians are drawn in order. */
export const finer = {
  name: "finer",
  setup(setup) {
    setup.onLoad({ filter: /gsplat-unified-sort-worker\.js$/ }, ({ path }) => {
      const text = readFileSync(path, "utf8");
      if (!text.includes(FEW_BUCKETS))
        throw new Error("PlayCanvas computes its buckets differently: update scripts/engine.mjs");
      return { contents: text.replace(FEW_BUCKETS, FEW_BUCKETS.replace("10", `${MIN_BITS}`)), loader: "js" };
    });
  },
};

/** Removes unreachable modules. Their constructors throw. */
export const smaller = {
  name: "smaller",
  setup(setup) {
    finer.setup(setup);
    setup.onLoad({ filter: SHADERS_LEFT_OUT }, ({ path }) => instead(path, 'const none = "";'));
    setup.onLoad({ filter: XR_LEFT_OUT }, ({ path }) => instead(path, "class none { update() {} }"));
    setup.onLoad({ filter: MODULES_LEFT_OUT }, ({ path }) =>
      instead(path, 'class none { constructor() { throw new Error("left out of PlayCanvas: scripts/engine.mjs"); } }'),
    );
  },
};

/** Name of the entry point for the lower half of PlayCanvas, without the scene and its components. */
export const LOWER = "lower-half";
const SCENE = "./node_modules/playcanvas/build/playcanvas/src/scene/";
const LOWER_HALF = ["renderer/forward-renderer", "materials/standard-material", "gsplat-unified/gsplat-manager"];

/**
 * Splits PlayCanvas into chunks. With the extra entry point, modules that both entry points need become a shared chunk.
 */
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

const METHOD = /^\t(?:static )?(\w+)\([^\n]*\) \{\n(?:\t\t[^\n]*\n|\n)*\t\},?\n/gm;

const CONSTANT = /^\tstatic ([A-Z]+) = [^\n]*\n/gm;

const MATH = fileURLToPath(new URL("../node_modules/playcanvas/build/playcanvas/src/core/math/", import.meta.url));

/** Returns the sources that a module imports, directly or indirectly, by path. */
function imported(path, found = new Map()) {
  if (found.has(path)) return found;
  const text = readFileSync(path, "utf8");
  found.set(path, text);
  for (const [, name] of text.matchAll(/^(?:import|export)(?! type)[^;]*? from "(\.[^"]+)"/gm))
    imported(join(dirname(path), name), found);
  return found;
}

/** Removes members of PlayCanvas's vector classes that the page's bundle does not use, directly or indirectly. */
export const vectors = {
  name: "vectors",
  setup(setup) {
    const main = fileURLToPath(new URL("../src/main.ts", import.meta.url)),
      ours = [...imported(main).values()],
      files = ["math", "quat", "vec3"].map((name) => readFileSync(`${MATH}${name}.js`, "utf8")),
      methods = files.flatMap((text) => [...text.matchAll(METHOD)]),
      asked = new Set(["constructor"]);
    const ask = (text) => {
      for (const [, name] of text.matchAll(/(?<!\bMath)\.(\w+)\(/g)) {
        if (asked.has(name) || name === "toString") continue;
        asked.add(name);
        for (const [body, other] of methods) if (other === name) ask(body);
      }
    };
    for (const text of ours) ask(text);
    for (const text of files) ask(text.replace(METHOD, ""));
    for (const [body, name] of methods) if (name === "constructor") ask(body);
    const isUsed = (name) => [...ours, ...files].some((text) => new RegExp(`\\b(Vec3|Quat)\\.${name}\\b`).test(text));
    setup.onLoad({ filter: /core\/math\/(math|quat|vec3)\.js$/ }, ({ path }) => {
      const contents = readFileSync(path, "utf8")
        .replace(METHOD, (body, name) => (asked.has(name) ? body : ""))
        .replace(CONSTANT, (line, name) => (isUsed(name) ? line : ""));
      return { contents, loader: "js" };
    });
  },
};
