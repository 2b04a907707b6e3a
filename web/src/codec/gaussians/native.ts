// Packet decoder in WebAssembly, several times as fast as the plain one and bit for bit the same.

import { HALF_WIDTHS, INVERSE_SCALES, NORMAL } from "../../entropy/tables.ts";
import { countLanes } from "../../packets/plan.ts";
import { BLOCK, compress, ROUNDS } from "../../sha256.ts";
import { splatsIn } from "../splats.ts";
import { COEFFICIENTS, COLUMNS } from "./layout.ts";
import { MODULE } from "./native_module.ts";
import { type Decoded, type GaussianPacketDecoder, PacketDecoder } from "./packet.ts";
import type { SideInfo } from "./side_info.ts";
import { constantTerms } from "./steps.ts";
import { FRACTIONS, WHOLES } from "./to_splats.ts";

/** Length of a row of the module's table of the transform. */
const TRANSFORM_STRIDE = 16;
/** Constants of the module's text, which `scripts/native.mjs` describes. */
const OFFSET = 45,
  PREFIXES = "!#%&}~";
const NO_ROWS = new Float64Array();
/** Functions that the module imports. */
const IMPORTS = { math: { sin: Math.sin, cos: Math.cos } };

/** Functions of `native/gaussians.c`, and addresses of its tables. */
interface Exports {
  readonly memory: WebAssembly.Memory;
  prepare(): void;
  begin(bytes: number): number;
  decode(
    bytes: number,
    count: number,
    harmonics: number,
    boxBits: number,
    latticeBits: number,
    maxPositionShift: number,
  ): number;
  convert(count: number, harmonics: number, half: number, size: number): number;
  widen(count: number): void;
  lanes(first: number, size: number, low: number, high: number, lanes: number): number;
  hash(blocks: number): void;
  readonly [table: string]: unknown;
}

let compiled: WebAssembly.Module | null | undefined;

/** Returns the compiled module; null if the page's policy or the engine does not allow it. */
function compiledModule(): WebAssembly.Module | null {
  if (compiled !== undefined) return compiled;
  try {
    const bytes = new Uint8Array(MODULE.length),
      starts = Int8Array.from({ length: 128 }, (_, code) => PREFIXES.indexOf(String.fromCharCode(code)));
    let size = 0;
    for (let n = 0; n < MODULE.length; n++) {
      const code = MODULE.charCodeAt(n),
        prefix = starts[code];
      bytes[size++] = (prefix < 0 ? code : 48 * prefix + MODULE.charCodeAt(++n) - 40) - OFFSET;
    }
    compiled = new WebAssembly.Module(bytes.subarray(0, size));
  } catch {
    compiled = null;
  }
  return compiled;
}

/** Returns an instance of the module; null where there is no WebAssembly, or no memory for another instance. */
export function instantiate<T>(): T | null {
  const module = compiledModule();
  try {
    return module && (new WebAssembly.Instance(module, IMPORTS).exports as T);
  } catch {
    return null;
  }
}

/** Bytes that are hashed at once, four blocks or a multiple, also enough for the counts of lanes. */
const HASHED_BYTES = 2 ** 16,
  /** Words of the state of SHA-256. */
  STATE_WORDS = 8,
  PREFIX_BYTES = 4 * (STATE_WORDS + BLOCK);

let helper: Exports | null | undefined;

/** Returns the instance that counts lanes and hashes, with its memory; null where there is none. */
function sharedInstance(): Exports | null {
  if (helper !== undefined) return helper;
  try {
    helper = instantiate<Exports>();
    helper?.begin(PREFIX_BYTES + HASHED_BYTES);
  } catch {
    helper = null; // its memory cannot grow
  }
  return helper;
}

/** Counts the elements of lanes as `countLanes` does: in WebAssembly if possible. */
export const countLanesFast: typeof countLanes = (first, size, seed, lanes) => {
  const exports = sharedInstance();
  if (!exports) return countLanes(first, size, seed, lanes);
  const address = exports.lanes(first, size, ...seed, lanes); // its memory may grow
  return new Int32Array(exports.memory.buffer, address, lanes).slice();
};

/** Updates the state of SHA-256 as `compress` does: in WebAssembly if possible. */
export const compressFast: typeof compress = (state, blocks) => {
  const exports = sharedInstance();
  if (!exports) return compress(state, blocks);
  for (let at = 0; at < blocks.length; at += HASHED_BYTES) {
    const piece = blocks.subarray(at, at + HASHED_BYTES),
      address = exports.begin(0),
      { buffer } = exports.memory,
      words = new Int32Array(buffer, address, STATE_WORDS + BLOCK);
    words.set(state);
    words.set(ROUNDS, STATE_WORDS);
    new Uint8Array(buffer, address + PREFIX_BYTES).set(piece);
    exports.hash(piece.length / BLOCK);
    state.set(words.subarray(0, STATE_WORDS));
  }
};

/** Decodes the packets of one kind: in WebAssembly if possible. Memory is only taken for the first packet. */
export class FastPacketDecoder implements GaussianPacketDecoder {
  #decoder: GaussianPacketDecoder | null = null;

  constructor(public info: SideInfo) {}

  /** Replaces the side information. The instance stays if its tables are the same. */
  setInfo(info: SideInfo): void {
    if (this.#decoder instanceof NativePacketDecoder && hasSameTables(this.info, info)) this.#decoder.info = info;
    else this.#decoder = null;
    this.info = info;
  }

  decode(payload: Uint8Array, block: number, count: number, mayReuse = false, asRows = !mayReuse): Decoded {
    this.#decoder ??= NativePacketDecoder.of(this.info) ?? new PacketDecoder(this.info);
    try {
      return this.#decoder.decode(payload, block, count, mayReuse, asRows);
    } catch (error) {
      if (!(error instanceof WebAssembly.RuntimeError)) throw error;
      // its memory cannot grow; the plain decoder needs less at once
      this.#decoder = new PacketDecoder(this.info);
      return this.#decoder.decode(payload, block, count, mayReuse);
    }
  }
}

function hasSameTables(one: SideInfo, other: SideInfo): boolean {
  const [some, others] = [one, other].map((info) => [
    info.baseExponents,
    info.scaleIndices,
    info.models,
    info.transform,
  ]);
  return some.every(
    (table, t) => table.length === others[t].length && table.every((value, n) => value === others[t][n]),
  );
}

/** Decodes the packets of one kind in WebAssembly. */
export class NativePacketDecoder implements GaussianPacketDecoder {
  readonly #exports: Exports;

  private constructor(
    public info: SideInfo,
    exports: Exports,
  ) {
    this.#exports = exports;
    const tables = {
      normal_cdf: NORMAL,
      inverse_scales: INVERSE_SCALES,
      widths: HALF_WIDTHS,
      coefficients: Int32Array.from(COEFFICIENTS.flat()),
      constant_terms: constantTerms(info.baseExponents),
      scale_indices: info.scaleIndices,
      initial_models: info.models,
      fractions: FRACTIONS,
      wholes: WHOLES,
      transform: paddedTransform(info),
    };
    for (const [name, values] of Object.entries(tables)) this.#fill(name, values);
    this.#exports.prepare();
  }

  /** Returns a decoder; null where there is no WebAssembly. */
  static of(info: SideInfo): NativePacketDecoder | null {
    const exports = instantiate<Exports>();
    try {
      return exports && new NativePacketDecoder(info, exports);
    } catch {
      return null; // no memory for its tables
    }
  }

  #fill(table: string, values: Int32Array | Float64Array): void {
    const address = (this.#exports[table] as WebAssembly.Global).value as number,
      { buffer } = this.#exports.memory;
    if (values instanceof Int32Array) new Int32Array(buffer, address, values.length).set(values);
    else new Float64Array(buffer, address, values.length).set(values);
  }

  decode(payload: Uint8Array, block: number, count: number, mayReuse = false, asRows = !mayReuse): Decoded {
    const { boxes, blockMeans, degree, numHarmonicColumns, latticeBits, sizeLog, maxPositionShift } = this.info,
      { memory, begin, decode, convert, widen } = this.#exports,
      address = begin(payload.length);
    this.#fill("block_means", blockMeans.subarray(7 * block, 7 * block + 7));
    this.#fill("corner", boxes.corners.subarray(3 * block, 3 * block + 3));
    new Uint8Array(memory.buffer, address, payload.length).set(payload);
    const at = decode(payload.length, count, numHarmonicColumns, boxes.bits[block], latticeBits, maxPositionShift);
    const floats = convert(count, numHarmonicColumns, 2 ** (sizeLog - latticeBits - 1), 2 ** sizeLog),
      sizes = 8 * COLUMNS * count;
    if (asRows) widen(count);
    const part = (begin: number, bytes: number): readonly [ArrayBuffer, number] =>
      mayReuse ? [memory.buffer, begin] : [memory.buffer.slice(begin, begin + bytes), 0];
    const [buffer, first] = part(at, sizes + 4 * numHarmonicColumns * count),
      [values, start] = part(floats, 4 * (14 + numHarmonicColumns) * count);
    return {
      rows: asRows ? new Float64Array(buffer, first, COLUMNS * count) : NO_ROWS,
      integers: asRows ? undefined : new Uint8Array(buffer, first, sizes),
      harmonics: new Int32Array(buffer, first + sizes, numHarmonicColumns * count),
      splats: splatsIn(count, degree, new Float32Array(values, start, (14 + numHarmonicColumns) * count)),
    };
  }
}

/** Returns the transform of the harmonics with rows of equal length. */
function paddedTransform({ transform, numHarmonicColumns }: SideInfo): Float64Array {
  const number = numHarmonicColumns / 3,
    padded = new Float64Array(TRANSFORM_STRIDE * number);
  for (let k = 0; k < number; k++) padded.set(transform.subarray(number * k, number * (k + 1)), TRANSFORM_STRIDE * k);
  return padded;
}
