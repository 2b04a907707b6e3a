// Builds the bundles. Workers start from text embedded in the page's script, so that a page loads one file. Pages whose
// policy forbids `blob:` load worker files instead.

import { createHash } from "node:crypto";
import { readdirSync, readFileSync } from "node:fs";
import { basename, dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

import { build, transform } from "esbuild";
import { minify } from "terser";

import { finer, LOWER, lower, smaller, vectors } from "./engine.mjs";

const root = fileURLToPath(new URL("..", import.meta.url));
export const { version } = JSON.parse(readFileSync(`${root}package.json`, "utf8"));
/**
 * Properties that no program but ours sees, which get short names: not those of the page's or another package's
 * interface, or of JSON. Bundles of the same build have the same short names.
 */
const INTERNAL = `
  accept across activity addChanges addHeadset addKeyframes addMotion addPacket addPeriod admit anchorBytes
  applyAttribute arrivalIndexOfTrack arrivalIndices arrived axisCount axisDeviation baseCount baseDigest baseExponents
  batches batchesOf batchSize begins birthGroups bitsOf blockMeans blockSize boxes bundled bytesOf cancelConcealment
  canRetry changeMs checkConcealmentMemory closeness columnShifts compared completeRows concealed concealmentBytes
  confirmed conflicts contradicts contrasts copies corners covered damagedTiles damages datagramsLost decoder
  defaultDirection delaySeconds densityRadius deviations disconnected dispatch distances drawnChildren drawUnits
  droppedGroups duplicates elementDecoder elementsOf elementsPerByte endState enterHeadset expectedErrors exponent
  extents failuresAfter featureActivations fileHead firstBlock firstBytes firstFrame firstGroup firstNew firstPackets
  firstTrack forCamera forgetMotion forgetOffsets formatVersion frameMs framesOf framingBlocks framingGaussians
  fullScreen gainsOfDrawn gainsOfSplats gainsOfUnits gainsWithoutCopies gaussianDecoder gaussiansFor gopOf groupFrames
  growth hasAnswered hasCopies hasEnded hasHead hasManifestOf hasNew hasSentView hasUnknownBirth headBytes heads
  headSize helpOpen hideNotice identityAt idleMs indexInBlock initSegment initSegmentBytes initSegmentMs inputs intake
  integers invalidate isAllSent isComplete isCut isEmpty isFree isKept isKeyframe isLinear isLive isNew isOnlySource
  isReady isReceived isReordered isRetry isRetryable isSame isSameStream isSequence isSorting isTryingWhole isVerified
  isVisible isWebPage isWhole keptBytes keyframeBlock keyframeInfo kinds laneCounter lastOffsets latticeBits
  latticeShift leafIndex leafSize leaky leaveOut leftOut lengths linearSteps log2MotionUnits logDeviations logScales
  logStepRatios lookUpSession lostSequences manifest manifestBytes maxExcess maxPacketBytes maxPositionShift maxTiers
  mayIdle medianRadius members middle models moveBetween nacks nearestFirst nearestOthers newPackets nextView
  noGaussians noteChange noteFailure noteSorted noteUseless numBirths numBlocks numBytes numCoefficients numConcealed
  numElements numElementsOf numGaussians numHarmonicColumns numHidden numInitSegments numIntact numKept
  numKeyframesWhenDecoded numLatePackets numLowBits numMaskLogits numMotionTracks numNew numOffsets numPackets
  numReceived numRemoved numSymbols numTracks observedRows offsetStep onAdopted onAnswer onCamera onChange
  onContextAvailable onContextLost onInput onLiveHead onUse openFile orderDigest outcome owners packetBytes
  packetDecoder packetsOf paintedCanvas parents pictureChanged planBlock planIndices playableEnd playingLive
  pointCameraAt polynomials positionStep predictAxis ranges ranks receiveDatagrams receivedPacketBytes recordWhen redraw
  referenceOffsets referenceRows refusals rejected renderer reordered reorient repeatMs replacesDrawn replaceTiles
  reportCamera reportPlayable requestFrame requestId rescale residuals resultDigest rowSteps scaleIndices sceneInView
  sections sequence setCamera setConcealers setCooperative setInfo setLimits setMessage setRow settled setUp
  setViewpoint setVisible shifts showNotice showStatistics sideInfo sideInfoBytes sideInfoDigest signed simulation
  sizeLog spread squares stage stages stalledFrames started startWebGL stateOf stepsOfLogs stopProbabilities storeValues
  streamId subject surface symbolBytes symbolsDigest symbolsMissing takeHaveMessages tierOf tierSizes tileRequest
  tilesBytes tiling timed timeline trackProperties trackSpan transmittance transports trust unsigned upperBits
  upRotation useless viewComplete viewDependent viewUpdate visibleParts voxels voxelSize waited waitUntil wanted
  wasConcealed welcome withdraw withoutComparison withRenderer zeroPoints
`
  .trim()
  .split(/\s+/);
const SOURCES = readdirSync(`${root}src`, { recursive: true })
  .filter((name) => name.endsWith(".ts"))
  .sort()
  .map((name) => readFileSync(join(root, "src", name), "utf8"));

/** Digest of the sources and of this script. */
function digest() {
  const hash = createHash("sha256").update(readFileSync(fileURLToPath(import.meta.url)));
  for (const text of SOURCES) hash.update(text);
  return hash.digest("hex").slice(0, 8);
}

const LETTERS = "etnriaoslcdupmhgfbvywkxjqzETNRIAOSLCDUPMHGFBVYWKXJQZ0123456789";

/**
 * Returns a short name for each internal property: one letter for the most frequent ones. Similar names for properties
 * of the same module compress better.
 */
function shortNames() {
  const counts = new Map(INTERNAL.map((name) => [name, 0]));
  for (const word of SOURCES.flatMap((text) => text.match(/\w+/g)))
    if (counts.has(word)) {
      const count = counts.get(word) + 1;
      if (count === 1) counts.delete(word); // orders the map by first occurrence
      counts.set(word, count);
    }
  const { length } = LETTERS,
    frequent = INTERNAL.toSorted((a, b) => counts.get(b) - counts.get(a)).slice(0, length),
    others = [...counts.keys()].filter((name) => !frequent.includes(name)),
    short = (n) => (n < length ? LETTERS[n] : LETTERS[Math.floor(n / length) - 1] + LETTERS[n % length]);
  return Object.fromEntries([...frequent, ...others].map((name, n) => [name, `$${short(n)}`]));
}

const BUILD = JSON.stringify(digest());
const common = {
  bundle: true,
  minify: true,
  charset: "utf8",
  target: "es2022",
  absWorkingDir: root,
  write: false,
  legalComments: "none",
  define: { BUILD, SEPARATE: "false" },
  tsconfigRaw: { compilerOptions: { useDefineForClassFields: false } }, // avoids duplicate field names
  logLevel: "error",
  mangleProps: new RegExp(`^(${INTERNAL.join("|")})$`),
  mangleCache: shortNames(),
};
const banner = {
  js: `/* splatwire ${version} web receiver, Apache-2.0; with PlayCanvas (MIT) */`,
};

/** Functions of the module in WebAssembly, which the bundles call by their names. */
const EXPORTED = [...readFileSync(`${root}native/gaussians.c`, "utf8").matchAll(/EXPORT\((\w+)\)/g)].map((at) => at[1]);
for (const name of EXPORTED)
  if (INTERNAL.includes(name)) throw new Error(`${name} is a function of WebAssembly: remove it from INTERNAL`);

/** Builds bundles. Throws if a text is the name of a property that gets a short name, because it may stand for it. */
async function built(options) {
  const made = await build({ ...common, ...options }),
    quoted = new RegExp(`(["'\`])(${INTERNAL.join("|")})\\1`);
  for (const { path, text } of made.outputFiles) {
    const found = path.endsWith(".map") ? null : quoted.exec(text);
    if (found) throw new Error(`${basename(path)} has the name ${found[0]} as a text: remove it from INTERNAL`);
  }
  return made;
}

/** Returns the text of the receiver's worker. */
async function receiver() {
  const made = await built({ entryPoints: ["src/worker.ts"], format: "iife" });
  return smallest(made.outputFiles[0].text);
}

/**
 * Returns a script with the same effect: 7 % fewer compressed bytes than esbuild alone. `pure_getters` would save 0.1 %
 * more, but removes checks that read a property and do not use its value.
 */
async function smallest(script) {
  const options = { ecma: 2022, mangle: { toplevel: true }, format: { comments: /^ splatwire/ } },
    compress = { passes: 2, lhs_constants: false, if_return: false, conditionals: false },
    { code } = await minify(script, { ...options, compress });
  // inlines functions that are called once, but no constant that is used several times
  return (await minify(code, { ...options, module: true, compress: { ...compress, evaluate: false } })).code;
}

/** Module with a function that starts the receiver. All elements of a page share one URL of its text. */
const fromText = async () => `
  const text = ${JSON.stringify(await receiver())};
  let url;
  export const notStarted = "no worker: the page must allow worker-src blob: (CSP)";
  export default () => new Worker((url ??= URL.createObjectURL(new Blob([text], { type: "text/javascript" }))));`;
/** The name tells the worker which script started it, because a cache may deliver a file of another version. */
const fromFile = () => `
  export const notStarted = "no worker: the page must allow splatwire-worker.js in worker-src (CSP), or it is missing";
  export default () => new Worker(new URL("./splatwire-worker.js", import.meta.url), { name: ${BUILD} });`;

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

/** Minifies the element's style sheet. */
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

/**
 * Patches PlayCanvas's sorter, which creates a URL per application and never revokes it: one URL per page, or a file.
 */
function sorter(path, strict) {
  const text = readFileSync(path, "utf8");
  if (!BLOB.test(text)) throw new Error("PlayCanvas starts its sorter differently: update scripts/bundle.mjs");
  const made = text.match(BLOB)[0],
    address = strict ? 'new URL("./splatwire-sorter.js", import.meta.url)' : `(sorterUrl ??= ${made})`;
  const contents = `let sorterUrl;\n${text.replace(BLOB, address)}`;
  return { contents, loader: "js", resolveDir: dirname(path) };
}

/** Returns the text of each bundle of the page by name. The same sources and lock file give the same bytes. */
export async function bundles(strict = false) {
  const make = async (name, entry, less) => {
    const plugins = [worker(strict), ...less];
    const made = await built({
      entryPoints: { [name]: entry },
      outdir: ".",
      format: "esm",
      plugins,
      banner,
    });
    return made.outputFiles[0].text;
  };
  return [
    ["splatwire.js", await smallest(await make("splatwire", "src/main.ts", [vectors, looks]))],
    ["splatwire-view.js", await make("splatwire-view", "src/view.ts", [smaller])],
  ];
}

const SORTING = "node_modules/playcanvas/build/playcanvas/src/scene/gsplat-unified";
/** PlayCanvas's sorter, which it runs from text, as a file. */
const SORTER = `
  import { GSplatSortBinWeights } from "./${SORTING}/gsplat-sort-bin-weights.js";
  import { UnifiedSortWorker } from "./${SORTING}/gsplat-unified-sort-worker.js";
  globalThis.GSplatSortBinWeights = GSplatSortBinWeights;
  UnifiedSortWorker(self);`;

/** In the package, the renderer consists of two modules that bundlers see, each small enough for its own chunk. */
const drawing = (engine, view) => ({
  name: "drawing",
  setup(setup) {
    setup.onResolve({ filter: /^drawing:/ }, ({ path }) => ({ path: path.slice(8), external: true }));
    setup.onLoad({ filter: /render\/load\.ts$/ }, () => ({
      contents: `export async function loadRenderer() {
        const [{ WebGLRenderer }] = await Promise.all([import("drawing:${view}"), import("drawing:${engine}")]);
        return WebGLRenderer;
      }`,
      loader: "js",
    }));
  },
});

/** Integrations with other programs: external packages, our decoder and our element stay separate modules. */
const ownModules = {
  name: "own",
  setup(setup) {
    setup.onResolve({ filter: /\.\.\/(decoder|index)\.ts$/ }, ({ path }) => ({
      path: path.replace(/^.*\/(\w+)\.ts$/, "./$1.js"),
      external: true,
    }));
  },
};
const INTEGRATIONS = {
    playcanvas: "src/integrations/playcanvas.ts",
    three: "src/integrations/three.ts",
    "three-core": "src/integrations/three_core.ts",
    babylon: "src/integrations/babylon.ts",
    react: "src/integrations/react.ts",
  },
  THEIRS = ["playcanvas", "three", "@sparkjsdev/spark", "react", "node:*"];

/** Returns the files of the npm package by name: modules with source maps, and workers for pages without `blob:`. */
export async function modules() {
  const found = [];
  const make = async (entryPoints, more) => {
    // node prints the source line of an uncaught error
    const files = { sourcemap: true, lineLimit: 1000 };
    const made = await built({ entryPoints, outdir: ".", ...files, banner, ...more });
    for (const { path, contents } of made.outputFiles)
      if (!basename(path).startsWith(LOWER)) found.push([basename(path), contents]);
  };
  const esm = { format: "esm" };
  await make({ decoder: "src/decoder.ts" }, esm);
  await make({ clip: "src/clip.ts" }, { ...esm, plugins: [worker(false)] });
  const element = async (name, view, engine, strict) => {
    const plugins = [worker(strict), vectors, looks, drawing(`./${engine}.js`, `./${view}.js`)];
    await make({ [name]: "src/index.ts" }, { ...esm, plugins });
    const parts = { ...esm, plugins: [worker(strict), smaller, lower], splitting: true, chunkNames: engine };
    await make({ [view]: "src/render/webgl_renderer.ts", [LOWER]: LOWER }, parts);
  };
  await element("index", "view", "engine", false);
  await element("strict", "strict-view", "strict-engine", true);
  const integrations = { ...esm, external: THEIRS, plugins: [ownModules] };
  await make(INTEGRATIONS, integrations);
  const generator = { "splat-transform": "src/integrations/splat_transform.ts" };
  await make(generator, { ...integrations, outExtension: { ".js": ".mjs" } });
  await make({ "splatwire-worker": "src/worker.ts" }, { format: "iife", define: { BUILD, SEPARATE: "true" } });
  const stdin = { contents: SORTER, resolveDir: root, sourcefile: "splatwire-sorter.js" };
  await make(undefined, { format: "iife", plugins: [finer], stdin, outfile: "splatwire-sorter.js", outdir: undefined });
  return found;
}
