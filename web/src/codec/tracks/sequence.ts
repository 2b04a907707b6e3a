// Received packets of a clip, and its decoded frames. Counterpart of `splatwire.sequence.decoding`.
//
// Arrays of tracks are by arrival index or by row; only `arrivalIndexOfTrack` is by track number. An arrival
// index is the index of a track's keyframe Gaussian in order of arrival (`KeyframeGaussians`); a row is an index in the
// arrays of one group (`DecodedGroup`).

import { ByteReader } from "../../bytes.ts";
import { Growth } from "../../conceal/grow.ts";
import type { Packet } from "../../packets/packet.ts";
import { FIRST_FRAME } from "../../packets/section_names.ts";
import type { DecodedFrame, SequenceDecoder } from "../element_decoder.ts";
import { checkMemory } from "../memory.ts";
import { emptySplats, type Splats, subSplats } from "../splats.ts";
import { KeyframeGaussians } from "./keyframe_gaussians.ts";
import { BEGINS, ENDS, GAP_AFTER, GAP_BEFORE, HEADER_FIELDS, NUM_CHANNELS, TRACK } from "./layout.ts";
import { type DecodedMotion, FastMotionPacketDecoder } from "./motion_packets.ts";
import { LostMotionPredictor, repeatLastOffset } from "./motion_prediction.ts";
import { HELD, HIDDEN, INTERPOLATED, positionsOf, select } from "./selection.ts";
import type { SequenceInfo } from "./side_info.ts";
import type { Timeline } from "./timeline.ts";
import type { TrackOffsets, TrackProperties } from "./track_offsets.ts";
import { moveRows } from "./trajectories.ts";

/** A decoded frame. */
export interface SequenceFrame extends DecodedFrame {
  /** Track of each Gaussian. */
  readonly tracks: Int32Array;
}

/** Size of the cache of decoded motion, bytes. A short clip fits in completely. */
const CACHE_BYTES = 192 << 20;
/** Concealers for tracks with lost motion. */
const CONCEALERS = ["motion", "hold", "drop"];

/** State of the tracks at the end of a group, by arrival index. */
interface ConcealmentState {
  readonly group: number;
  readonly alive: Uint8Array;
  readonly wasConcealed: Uint8Array;
  readonly offsets: Float32Array;
}

interface ConcealedTracks {
  /** Tracks with estimated motion (1), by row. */
  readonly concealed: Uint8Array;
}

/** Tracks with their offsets in one array. */
interface TrackBatch {
  readonly count: number;
  /**
   * Shape (frames, tracks, channels), or of one frame for tracks that stand still. Channels and units are those of
   * `offsetsOf`.
   */
  readonly offsets: Float32Array;
}

/**
 * Decoded motion of a group. A row is one entry of its arrays: first the headers of the received packets in order, then
 * the tracks without received motion. A track that two packets contain has two rows; the second one has no frame.
 */
interface DecodedGroup extends Omit<TrackOffsets, "offsets">, ConcealedTracks {
  readonly group: number;
  /** Offsets of all rows, in order. */
  readonly batches: readonly TrackBatch[];
  /** Number of all keyframe Gaussians received when the group was decoded; once there are more, it is decoded again. */
  readonly numKeyframesWhenDecoded: number;
  /** Tracks that are not drawn (1), by row. */
  readonly hidden: Uint8Array;
  /** Gains of size and opacity that cover hidden tracks, shape (rows, 2); null if none are covered. */
  readonly gains: Float32Array | null;
  readonly isReceived: (packet: Packet) => boolean;
  readonly concealer: string;
  readonly endState: ConcealmentState;
}

export class Sequence implements SequenceDecoder {
  readonly concealers = CONCEALERS;
  packets: Packet[] = [];
  numLatePackets = 0;
  readonly #keyframes: KeyframeGaussians;
  readonly #motion: Packet[][];
  /** Number of received elements of each group. */
  readonly #receivedElements: number[];
  /** First group with motion packets still in memory. */
  #firstGroup = 0;
  /** Blocks with motion packets that arrived after their group was released. */
  readonly #lateBlocks = new Set<number>();
  #motionDecoder: FastMotionPacketDecoder;
  #cachedBytes = 0;
  /** Gaussians of the last frame, if their memory may be used again. */
  #reusedSplats = emptySplats(0, 0);
  readonly #cache = new Map<Packet, DecodedMotion>();
  #current: DecodedGroup | null = null;
  #previous: ConcealmentState | null = null;

  /** `numBytes` is the number of received bytes of the stream. */
  constructor(
    public info: SequenceInfo,
    public numBytes: number,
  ) {
    this.#keyframes = new KeyframeGaussians(info);
    this.#motion = info.groups.map(() => []);
    this.#receivedElements = info.groups.map(() => 0);
    this.#motionDecoder = new FastMotionPacketDecoder(info);
  }

  /** Continues with a longer clip, which has more groups. */
  grow(info: SequenceInfo): void {
    // an encoder fits the models to the first group that moves, which an earlier head may not have
    if (info.models.some((state, n) => state !== this.info.models[n]))
      this.#motionDecoder = new FastMotionPacketDecoder(info);
    this.info = info;
    this.#keyframes.grow(info);
    for (let group = this.#motion.length; group < info.groups.length; group++) {
      this.#motion.push([]);
      this.#receivedElements.push(0);
    }
  }

  addKeyframes(group: number, first: number, rows: Float64Array, block: number, splats: Splats): void {
    this.#receivedElements[group] += splats.count;
    this.#keyframes.add(first, rows, block, splats);
  }

  addMotion(group: number, packet: Packet): void {
    this.#receivedElements[group] += packet.count;
    if (group < this.#firstGroup) {
      this.numLatePackets++;
      this.#lateBlocks.add(packet.block);
      return;
    }
    this.#motion[group].push(packet);
    this.packets.push(packet);
    this.numBytes += packet.payload.length;
    if (this.#current?.group === group) this.#current = null;
  }

  get timeline(): Timeline {
    return this.info.timeline;
  }

  get firstFrame(): number {
    const section = this.info.sections.get(FIRST_FRAME);
    if (!section) return 0;
    const reader = new ByteReader(section, "section 'first_frame'"),
      number = reader.unsigned();
    reader.finish();
    return number;
  }

  get playableEnd(): number {
    const { groups, timeline } = this.info,
      last = groups.length - 1;
    return this.#isWhole(last) ? timeline.numFrames : last * timeline.groupFrames;
  }

  #isWhole(group: number): boolean {
    const { numBirths, numMotionTracks } = this.info.groups[group];
    return this.#receivedElements[group] >= numBirths + numMotionTracks;
  }

  forgetMotion(number: number): number[] {
    const end = Math.floor(number / this.info.timeline.groupFrames),
      blocks = new Set(this.#lateBlocks);
    this.#lateBlocks.clear();
    for (; this.#firstGroup < end; this.#firstGroup++) {
      for (const packet of this.#motion[this.#firstGroup].splice(0)) {
        blocks.add(packet.block);
        this.#cachedBytes -= this.#cache.get(packet)?.offsets.byteLength ?? 0;
        this.#cache.delete(packet);
      }
    }
    if (blocks.size) this.packets = this.packets.filter(({ block }) => !blocks.has(block));
    return [...blocks];
  }

  /** Returns the number of frames of a group. */
  framesOf(group: number): number {
    const { numFrames, groupFrames } = this.info.timeline;
    return Math.min(groupFrames, numFrames - group * groupFrames);
  }

  /**
   * Returns a frame. Conceals the motion of packets that are lost or rejected by `isReceived`. With `reuse`, its
   * Gaussians are valid until the next call.
   */
  frame(number: number, isReceived: (packet: Packet) => boolean, concealer = "motion", reuse = false): SequenceFrame {
    const group = Math.floor(number / this.info.timeline.groupFrames),
      { arrivalIndices, begins, ends, batches, concealed, hidden, gains } = this.#decodeGroup(
        group,
        isReceived,
        concealer,
      ),
      at = number - group * this.info.timeline.groupFrames,
      here = drawnRows(begins, ends, hidden, at),
      tracks = here.map((n) => this.#keyframes.tracks[arrivalIndices[n]]);
    const { degree } = this.#keyframes.splats,
      target = reuse && this.#reusedSplats.count >= here.length ? this.#reusedSplats : emptySplats(here.length, degree),
      splats = subSplats(target, 0, here.length);
    if (reuse) this.#reusedSplats = target;
    let first = 0,
      to = 0,
      numConcealed = 0;
    for (const batch of batches) {
      const begin = to,
        end = first + batch.count;
      while (here[to] < end) to++;
      moveRows(
        this.#keyframes.splats,
        arrivalIndices,
        here.subarray(begin, to),
        offsetsIn(batch, at),
        first,
        splats,
        begin,
      );
      first = end;
    }
    for (let i = 0; i < here.length; i++) {
      const n = here[i];
      if (gains) enlarge(splats, i, gains[2 * n], gains[2 * n + 1]);
      numConcealed += concealed[n];
    }
    return { number, splats, tracks, numConcealed, isWhole: this.#isWhole(group) };
  }

  /** Decodes motion of the next group in advance, for up to `ms` milliseconds. */
  prefetch(number: number, ms: number): void {
    const group = (Math.floor(number / this.info.timeline.groupFrames) + 1) % this.#motion.length,
      end = performance.now() + ms;
    for (const packet of this.#motion[group]) {
      if (performance.now() > end) return;
      this.#decode(group, packet);
    }
  }

  #decodeGroup(group: number, isReceived: (packet: Packet) => boolean, concealer: string): DecodedGroup {
    const played = this.#current;
    const same =
      played?.isReceived === isReceived &&
      played.concealer === concealer &&
      played.numKeyframesWhenDecoded === this.#keyframes.count;
    if (same && played.group === group) return played;
    if (played && played.group !== group) this.#previous = played.endState;
    const before = this.#previous?.group === group - 1 ? this.#previous : null,
      found = this.#addUncovered(group, this.#receivedMotion(group, isReceived), before, isReceived, concealer);
    this.#current = found;
    return found;
  }

  /**
   * Returns the received motion of a group, and the tracks that its packets cover (1), including those that ended, by
   * arrival index.
   */
  #receivedMotion(
    group: number,
    isReceived: (packet: Packet) => boolean,
  ): { received: ReceivedTracks; covered: Uint8Array } {
    const { info } = this,
      keyframes = this.#keyframes,
      frames = this.framesOf(group),
      covered = new Uint8Array(keyframes.count),
      found: DecodedMotion[] = [];
    let rows = 0;
    this.#check(rows, frames);
    for (const packet of this.#motion[group].filter(isReceived)) {
      const decoded = this.#decode(group, packet);
      if (!decoded) continue;
      found.push(decoded);
      rows += packet.count;
      this.#check(rows, frames);
      const { headers } = decoded,
        last = HEADER_FIELDS * (packet.count - 1),
        end = Math.min(headers[last + TRACK] + headers[last + GAP_AFTER] + 1, info.numTracks);
      for (let track = Math.max(headers[TRACK] - headers[GAP_BEFORE], 0); track < end; track++)
        if (keyframes.arrivalIndexOfTrack[track] >= 0) covered[keyframes.arrivalIndexOfTrack[track]] = 1;
    }
    return { received: joinPackets(found, keyframes.arrivalIndexOfTrack, frames, keyframes.count), covered };
  }

  /**
   * Throws `BitstreamError` if the motion of a group needs too much memory: the joined offsets of all tracks, and the
   * offsets of the decoded packets, which have `rows` tracks, or the estimates of lost tracks.
   */
  #check(rows: number, frames: number): void {
    const { count } = this.#keyframes,
      needed = (count + Math.max(count, rows)) * frames * NUM_CHANNELS * Float32Array.BYTES_PER_ELEMENT;
    checkMemory(needed, this.numBytes, `the motion of ${count} tracks`);
  }

  /** Decodes a motion packet. Returns null if the keyframe Gaussian of one of its tracks was not received. */
  #decode(group: number, packet: Packet): DecodedMotion | null {
    const { info } = this,
      frames = this.framesOf(group),
      cached = this.#cache.get(packet);
    if (cached) return cached;
    const { payload, count } = packet,
      { firstNew } = info.groups[group],
      decoded = this.#motionDecoder.decode({ payload, count, frames, firstNew }, (headers) =>
        this.#keyframes.of(headers, group),
      );
    if (!decoded) return null;
    scalePositions(decoded.offsets, 2 ** info.log2MotionUnits[group]);
    this.#addToCache(packet, decoded);
    return decoded;
  }

  /** Adds decoded motion to the cache and removes the oldest entries beyond `CACHE_BYTES`. */
  #addToCache(packet: Packet, decoded: DecodedMotion): void {
    this.#cache.set(packet, decoded);
    this.#cachedBytes += decoded.offsets.byteLength;
    for (const [oldest, { offsets }] of this.#cache) {
      if (this.#cachedBytes <= CACHE_BYTES || oldest === packet) return;
      this.#cache.delete(oldest);
      this.#cachedBytes -= offsets.byteLength;
    }
  }

  /** Adds the tracks that no received packet covers. Their motion is estimated, or 0 if the group has none. */
  #addUncovered(
    group: number,
    { received, covered }: { received: ReceivedTracks; covered: Uint8Array },
    before: ConcealmentState | null,
    isReceived: (packet: Packet) => boolean,
    concealer: string,
  ): DecodedGroup {
    const { info } = this,
      keyframes = this.#keyframes,
      { firstNew, numBirths, numMotionTracks } = info.groups[group],
      frames = this.framesOf(group),
      first = group * info.timeline.groupFrames,
      uncoveredIndices: number[] = [];
    for (let arrivalIndex = 0; arrivalIndex < keyframes.count; arrivalIndex++) {
      if (covered[arrivalIndex]) continue;
      const track = keyframes.tracks[arrivalIndex],
        isNew = track >= firstNew && track < firstNew + numBirths;
      const ended = (info.lifetimes.ends.get(track) ?? Infinity) <= first;
      if (!ended && (isNew || (before ? before.alive[arrivalIndex] : track < firstNew)))
        uncoveredIndices.push(arrivalIndex);
    }
    const found = appendUncovered(received, uncoveredIndices, frames, numMotionTracks > 0),
      numReceived = received.arrivalIndices.length,
      hidden = new Uint8Array(found.arrivalIndices.length),
      batches = [...received.batches];
    uncoveredIndices.forEach((arrivalIndex, n) => {
      [found.begins[numReceived + n], found.ends[numReceived + n]] = this.#lifetime(arrivalIndex, group);
    });
    let gains: Float32Array | null = null;
    if (numMotionTracks && uncoveredIndices.length) {
      const trackProperties = this.#trackProperties(before, group),
        { lastOffsets } = trackProperties,
        offsets = byTrack(batches, numReceived, uncoveredIndices.length, frames),
        out = offsets.subarray(numReceived * frames * NUM_CHANNELS),
        receivedOffsets = { ...received, offsets: offsets.subarray(0, numReceived * frames * NUM_CHANNELS) },
        methods =
          concealer === "motion"
            ? this.#interpolate(receivedOffsets, Int32Array.from(uncoveredIndices), trackProperties, group, out)
            : new Uint8Array(uncoveredIndices.length).fill(concealer === "drop" ? HIDDEN : HELD);
      methods.forEach((method, n) => {
        if (method !== INTERPOLATED) repeatLastOffset(lastOffsets, uncoveredIndices[n], out, n * frames, frames);
        hidden[numReceived + n] = Number(method === HIDDEN);
      });
      batches.push({ count: uncoveredIndices.length, offsets: transposed(out, uncoveredIndices.length, frames) });
      if (concealer === "motion" && hidden.includes(1)) gains = this.#growth({ ...found, offsets }, hidden, frames);
    } else
      batches.push({
        count: uncoveredIndices.length,
        offsets: new Float32Array(uncoveredIndices.length * NUM_CHANNELS),
      });
    return {
      ...found,
      batches,
      hidden,
      gains,
      group,
      isReceived,
      concealer,
      numKeyframesWhenDecoded: keyframes.count,
      endState: this.#concealmentState(group, found, batches, before, frames),
    };
  }

  /** Returns the first frame and the end frame of a track in a group, as known without its motion. */
  #lifetime(arrivalIndex: number, group: number): [number, number] {
    const { info } = this,
      keyframes = this.#keyframes,
      frames = this.framesOf(group),
      track = keyframes.tracks[arrivalIndex],
      begin = keyframes.birthGroups[arrivalIndex] === group ? (info.lifetimes.begins.get(track) ?? 0) : 0,
      end = info.lifetimes.ends.get(track) ?? Infinity;
    return [Math.min(begin, frames - 1), Math.min(end - group * info.timeline.groupFrames, frames)];
  }

  /** Selects a method to cover each lost track. Writes the motion of tracks that are moved. */
  #interpolate(
    received: TrackOffsets,
    uncoveredIndices: Int32Array,
    trackProperties: TrackProperties,
    group: number,
    out: Float32Array,
  ): Uint8Array {
    const frames = this.framesOf(group),
      size = frames * NUM_CHANNELS,
      { begins, ends, arrivalIndices } = received,
      order = this.#rowsByTrack(arrivalIndices),
      complete = order.filter((n) => begins[n] === 0 && ends[n] === frames),
      predictor = new LostMotionPredictor(received, complete, this.#keyframes.birthGroups, trackProperties, frames),
      interpolate = predictor.predict.bind(predictor),
      lifetime = (arrivalIndex: number) => this.#lifetime(arrivalIndex, group),
      methods = select(received, order, uncoveredIndices, frames, trackProperties, interpolate, lifetime),
      moving = rowsWhere(uncoveredIndices.length, (n) => methods[n] === INTERPOLATED),
      found = interpolate(
        new Uint8Array(arrivalIndices.length),
        moving.map((n) => uncoveredIndices[n]),
      );
    moving.forEach((n, i) => out.set(found.subarray(i * size, (i + 1) * size), n * size));
    return methods;
  }

  /** Returns the rows by ascending track. */
  #rowsByTrack(arrivalIndices: Int32Array): Int32Array {
    const rowOf = new Int32Array(this.#keyframes.count).fill(-1);
    for (let row = arrivalIndices.length; row--; ) rowOf[arrivalIndices[row]] = row; // the first one counts
    return this.#keyframes.arrivalIndexOfTrack
      .filter((arrivalIndex) => arrivalIndex >= 0 && rowOf[arrivalIndex] >= 0)
      .map((arrivalIndex) => rowOf[arrivalIndex]);
  }

  /** Returns factors of size and opacity with which drawn tracks cover hidden ones, shape (rows, 2). */
  #growth({ arrivalIndices: indicesOfRows, offsets }: TrackOffsets, hidden: Uint8Array, frames: number): Float32Array {
    const keyframes = this.#keyframes,
      { scales, opacities } = keyframes.splats,
      gains = new Float32Array(2 * indicesOfRows.length),
      counted = new Uint8Array(keyframes.count),
      isFirst = (row: number): boolean => !counted[indicesOfRows[row]] && Boolean((counted[indicesOfRows[row]] = 1)),
      rows = rowsWhere(indicesOfRows.length, isFirst), // a track may occur twice
      arrivalIndices = rows.map((row) => indicesOfRows[row]),
      growth = new Growth({
        positions: positionsOf(keyframes.splats, arrivalIndices, offsets, (n) => rows[n] * frames),
        sizes: Float32Array.from(arrivalIndices, (arrivalIndex) =>
          Math.cbrt(scales[3 * arrivalIndex] * scales[3 * arrivalIndex + 1] * scales[3 * arrivalIndex + 2]),
        ),
        tierSizes: null,
        opacities: Float32Array.from(arrivalIndices, (arrivalIndex) => opacities[arrivalIndex]),
        isReceived: Uint8Array.from(rows, (row) => 1 - hidden[row]),
        indices: arrivalIndices.map((arrivalIndex) => keyframes.tracks[arrivalIndex]),
      });
    rows.forEach((row, n) => {
      if (!hidden[row]) gains.set(growth.of(n), 2 * row);
    });
    return gains;
  }

  #trackProperties(before: ConcealmentState | null, group: number): TrackProperties {
    const { info } = this,
      keyframes = this.#keyframes,
      size = keyframes.count * NUM_CHANNELS,
      unit = 2 ** (info.keyframeInfo.sizeLog - info.keyframeInfo.latticeBits - 1);
    return {
      splats: keyframes.splats,
      lastOffsets: before ? resized(before.offsets, size) : new Float32Array(size),
      wasConcealed: before?.wasConcealed ?? null,
      isNew: (arrivalIndex) => keyframes.birthGroups[arrivalIndex] === group,
      hasUnknownBirth: (arrivalIndex) =>
        keyframes.birthGroups[arrivalIndex] === group && !info.lifetimes.begins.get(keyframes.tracks[arrivalIndex]),
      positionStep: (arrivalIndex) =>
        unit *
        2 **
          (keyframes.shifts[NUM_CHANNELS * arrivalIndex] + info.log2MotionUnits[keyframes.birthGroups[arrivalIndex]]),
    };
  }

  #concealmentState(
    group: number,
    { arrivalIndices, ends, concealed }: ReceivedTracks & ConcealedTracks,
    batches: readonly TrackBatch[],
    before: ConcealmentState | null,
    frames: number,
  ): ConcealmentState {
    const count = this.#keyframes.count,
      last = before ? resized(before.offsets, count * NUM_CHANNELS) : new Float32Array(count * NUM_CHANNELS),
      alive = new Uint8Array(count),
      wasConcealed = new Uint8Array(count);
    let n = 0;
    for (const batch of batches) {
      const offsets = offsetsIn(batch, frames - 1);
      for (let from = 0; from < offsets.length; n++, from += NUM_CHANNELS) {
        const arrivalIndex = arrivalIndices[n],
          to = arrivalIndex * NUM_CHANNELS;
        if (ends[n] !== frames) continue;
        alive[arrivalIndex] = 1;
        wasConcealed[arrivalIndex] = concealed[n];
        for (let c = 0; c < NUM_CHANNELS; c++) last[to + c] = offsets[from + c];
      }
    }
    return { group, alive, wasConcealed, offsets: last };
  }
}

/** Returns the offsets of a batch in a frame, shape (tracks, channels). */
function offsetsIn({ count, offsets }: TrackBatch, frame: number): Float32Array {
  const size = NUM_CHANNELS * count,
    first = frame * size < offsets.length ? frame * size : 0;
  return offsets.subarray(first, first + size);
}

/** Tracks of the received packets. */
interface ReceivedTracks extends Omit<TrackOffsets, "offsets"> {
  readonly batches: readonly TrackBatch[];
}

/**
 * Joins the tracks of all packets, with room for `numSpare` more. If a track occurs twice, the first row counts: later
 * rows of the same track have no frame.
 */
function joinPackets(
  found: readonly DecodedMotion[],
  indexOfTrack: Int32Array,
  frames: number,
  numSpare: number,
): ReceivedTracks {
  const seen = new Uint8Array(indexOfTrack.length),
    batches = found.map(({ headers, offsets }) => ({ count: headers.length / HEADER_FIELDS, offsets })),
    rows = batches.reduce((sum, { count }) => sum + count, 0),
    [arrivalIndices, begins, ends] = [0, 1, 2].map(() => new Int32Array(rows + numSpare).subarray(0, rows));
  let n = 0;
  for (const { headers } of found) {
    for (let at = 0; at < headers.length; at += HEADER_FIELDS, n++) {
      const arrivalIndex = (arrivalIndices[n] = indexOfTrack[headers[at + TRACK]]);
      if (seen[arrivalIndex]) continue;
      seen[arrivalIndex] = 1;
      begins[n] = Math.min(Math.max(headers[at + BEGINS], 0), frames - 1);
      ends[n] = Math.min(Math.max(headers[at + ENDS], begins[n]), frames);
    }
  }
  return { arrivalIndices, begins, ends, batches };
}

/** Returns the offsets by track, shape (tracks, frames, channels): of `numReceived` tracks, and zeros for `others`. */
function byTrack(batches: readonly TrackBatch[], numReceived: number, others: number, frames: number): Float32Array {
  const all = new Float32Array((numReceived + others) * frames * NUM_CHANNELS);
  let at = 0;
  for (const { count, offsets } of batches) {
    all.set(transposed(offsets, frames, count), at);
    at += offsets.length;
  }
  return all;
}

/** Returns an array of shape (rows, columns, channels) with shape (columns, rows, channels). */
function transposed(offsets: Float32Array, rows: number, columns: number): Float32Array {
  const found = new Float32Array(offsets.length);
  let at = 0;
  for (let j = 0; j < columns; j++)
    for (let i = 0; i < rows; i++)
      for (let c = 0; c < NUM_CHANNELS; c++) found[at++] = offsets[(i * columns + j) * NUM_CHANNELS + c];
  return found;
}

/**
 * Appends the tracks that no received packet of motion covers, for all frames. With `isLost`, their motion is estimated
 * later; otherwise the group has no motion.
 */
function appendUncovered(
  received: ReceivedTracks,
  others: readonly number[],
  frames: number,
  isLost: boolean,
): ReceivedTracks & ConcealedTracks {
  const numReceived = received.arrivalIndices.length,
    count = numReceived + others.length,
    wider = ({ buffer }: Int32Array): Int32Array => new Int32Array(buffer, 0, count),
    concealed = new Uint8Array(count).fill(Number(isLost), numReceived),
    arrivalIndices = wider(received.arrivalIndices);
  arrivalIndices.set(others, numReceived);
  return {
    ...received,
    arrivalIndices,
    begins: wider(received.begins),
    ends: wider(received.ends).fill(frames, numReceived),
    concealed,
  };
}

/** Returns the rows of tracks that are drawn in a frame, ascending. */
function drawnRows(begins: Int32Array, ends: Int32Array, hidden: Uint8Array, at: number): Int32Array {
  const found = new Int32Array(begins.length);
  let some = 0;
  for (let n = 0; n < begins.length; n++) if (begins[n] <= at && at < ends[n] && !hidden[n]) found[some++] = n;
  return found.subarray(0, some);
}

/** Returns the rows that satisfy a condition, ascending. */
function rowsWhere(count: number, holds: (row: number) => boolean): Int32Array {
  const found = new Int32Array(count);
  let some = 0;
  for (let n = 0; n < count; n++) if (holds(n)) found[some++] = n;
  return found.subarray(0, some);
}

/** Multiplies the position channels of offsets, in place. */
function scalePositions(offsets: Float32Array, scale: number): void {
  if (scale === 1) return;
  for (let at = 0; at < offsets.length; at += NUM_CHANNELS) for (let a = 0; a < 3; a++) offsets[at + a] *= scale;
}

function resized(old: Float32Array, length: number): Float32Array {
  const wider = new Float32Array(length);
  wider.set(old);
  return wider;
}

/** Multiplies the size and the opacity of a Gaussian. */
function enlarge(splats: Splats, at: number, size: number, opacity: number): void {
  for (let a = 0; a < 3; a++) splats.scales[3 * at + a] *= size;
  splats.opacities[at] = Math.min(splats.opacities[at] * opacity, 1);
}
