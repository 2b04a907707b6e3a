// Decoders of motion packets: in WebAssembly, and a plain one that decodes bit for bit the same.

import { instantiate } from "../gaussians/native.ts";
import { HEADER_FIELDS, MAX_GROUP_FRAMES, MOVING, NUM_CHANNELS, STATE } from "./layout.ts";
import { decodeMotion } from "./motion.ts";
import { coefficients, normalisedPositions, predictionOrder, totalCoefficients } from "./predict.ts";
import type { SequenceInfo } from "./side_info.ts";
import { offsetsOf, polynomials, unitsOf } from "./trajectories.ts";

/**
 * Largest number of tracks of a packet that is decoded in WebAssembly, and largest number of its offsets, because the
 * memory of WebAssembly never shrinks.
 */
const MAX_TRACKS = 1 << 16,
  MAX_OFFSETS = 1 << 22;

/** Decoded motion packet: headers, and offsets of its tracks. */
export interface DecodedMotion {
  /** Shape (tracks, HEADER_FIELDS). */
  readonly headers: Int32Array;
  /** Shape (frames, tracks, channels). Channels and units are those of `offsetsOf`. */
  readonly offsets: Float32Array;
}

/** Properties of the tracks' keyframe Gaussians. */
export interface TrackKeyframes {
  /** Positions in units of motion, shape (tracks, 3). */
  readonly positions: Float64Array;
  /** log2 of the steps, shape (tracks, channels). */
  readonly shifts: Int32Array;
}

/** Motion packet as decoders need it. */
export interface MotionPacket {
  readonly payload: Uint8Array;
  /** Number of tracks. */
  readonly count: number;
  /** Number of frames of the group. */
  readonly frames: number;
  /** First track that is born in the group. */
  readonly firstNew: number;
}

interface MotionPacketDecoder {
  /** Decodes a packet. Returns null if `keyframesOf` does so for its headers. */
  decode(packet: MotionPacket, keyframesOf: (headers: Int32Array) => TrackKeyframes | null): DecodedMotion | null;
}

/** Decodes in WebAssembly if possible. */
export class FastMotionPacketDecoder implements MotionPacketDecoder {
  #native: MotionPacketDecoder | null | undefined;

  constructor(readonly info: SequenceInfo) {}

  decode(packet: MotionPacket, keyframesOf: (headers: Int32Array) => TrackKeyframes | null): DecodedMotion | null {
    const { count, frames } = packet;
    if (this.#native !== null && count <= MAX_TRACKS && count * frames * NUM_CHANNELS <= MAX_OFFSETS) {
      try {
        this.#native ??= NativeMotionPacketDecoder.of(this.info);
        if (this.#native) return this.#native.decode(packet, keyframesOf);
      } catch (error) {
        if (!(error instanceof WebAssembly.RuntimeError)) throw error;
        this.#native = null; // its memory cannot grow
      }
    }
    return new PlainMotionPacketDecoder(this.info).decode(packet, keyframesOf);
  }
}

export class PlainMotionPacketDecoder implements MotionPacketDecoder {
  constructor(readonly info: SequenceInfo) {}

  decode(
    { payload, count, frames, firstNew }: MotionPacket,
    keyframesOf: (headers: Int32Array) => TrackKeyframes | null,
  ): DecodedMotion | null {
    const { headers, residuals, numCoefficients } = decodeMotion(payload, this.info.models, count, frames, firstNew),
      keyframes = keyframesOf(headers);
    if (!keyframes) return null;
    const stride = count * NUM_CHANNELS,
      moving = movingOf(headers),
      offsets = new Float32Array(frames * stride),
      found = coefficients(keyframes.positions, moving, keyframes.shifts, residuals, numCoefficients),
      row = totalCoefficients(numCoefficients),
      units = unitsOf(this.info);
    for (let i = 0; i < count; i++)
      if (moving[i]) offsetsOf(found, i * row, frames, numCoefficients, units, offsets, i * NUM_CHANNELS, stride);
    return { headers, offsets };
  }
}

/** Returns the mask of moving tracks. */
function movingOf(headers: Int32Array): Uint8Array {
  const moving = new Uint8Array(headers.length / HEADER_FIELDS);
  for (let i = 0; i < moving.length; i++) moving[i] = Number(headers[HEADER_FIELDS * i + STATE] === MOVING);
  return moving;
}

/** Functions of `native/gaussians.c`, and the address of its tables. */
interface Exports {
  readonly memory: WebAssembly.Memory;
  readonly motion: WebAssembly.Global;
  begin(bytes: number): number;
  readMotion(bytes: number, count: number, frames: number, firstNew: number): number;
  offsets(moving: number): number;
}

export class NativeMotionPacketDecoder implements MotionPacketDecoder {
  #frames = 0;

  private constructor(
    info: SequenceInfo,
    readonly exports: Exports,
  ) {
    const { units, models } = this.#tables();
    units.set(unitsOf(info));
    models.set(info.models);
  }

  /** Returns a decoder; null where there is no WebAssembly. */
  static of(info: SequenceInfo): NativeMotionPacketDecoder | null {
    const exports = instantiate<Exports>();
    return exports && new NativeMotionPacketDecoder(info, exports);
  }

  /** Tables of the module: units of the channels, polynomials with one row per degree, initial models. */
  #tables(): { units: Float64Array; polynomials: Float64Array; models: Int32Array } {
    const { memory, motion } = this.exports,
      units = new Float64Array(memory.buffer, motion.value, NUM_CHANNELS + 1),
      table = new Float64Array(memory.buffer, motion.value + units.byteLength, MAX_GROUP_FRAMES ** 2);
    return { units, polynomials: table, models: new Int32Array(memory.buffer, table.byteOffset + table.byteLength) };
  }

  decode(
    { payload, count, frames, firstNew }: MotionPacket,
    keyframesOf: (headers: Int32Array) => TrackKeyframes | null,
  ): DecodedMotion | null {
    const { memory, begin, readMotion, offsets } = this.exports,
      address = begin(payload.length);
    if (frames !== this.#frames) {
      const table = this.#tables().polynomials,
        values = polynomials(frames);
      for (let n = 0; n < values.length; n++)
        table[MAX_GROUP_FRAMES * (n % frames) + Math.floor(n / frames)] = values[n];
      this.#frames = frames;
    }
    new Uint8Array(memory.buffer, address).set(payload);
    const headersAt = readMotion(payload.length, count, frames, firstNew),
      headers = new Int32Array(memory.buffer, headersAt, HEADER_FIELDS * count).slice(),
      keyframes = keyframesOf(headers);
    if (!keyframes) return null;
    const shiftsAt = headersAt + headers.byteLength;
    new Int32Array(memory.buffer, shiftsAt).set(keyframes.shifts);
    const positions = normalisedPositions(keyframes.positions),
      order = predictionOrder(positions, movingOf(headers), keyframes.shifts),
      positionsAt = 8 * Math.ceil((shiftsAt + keyframes.shifts.byteLength) / 8);
    new Float64Array(memory.buffer, positionsAt).set(positions);
    new Int32Array(memory.buffer, positionsAt + positions.byteLength).set(order);
    const at = offsets(order.length);
    return { headers, offsets: new Float32Array(memory.buffer, at, count * frames * NUM_CHANNELS).slice() };
  }
}
