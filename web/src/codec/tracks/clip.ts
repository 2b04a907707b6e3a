// What of a clip arrived, and what it looks like in any frame. The twin of `splatwire.clips.decoding`.

import { ByteReader } from "../../bytes.ts";
import type { Packet } from "../../packets/packet.ts";
import { checkMemory } from "../memory.ts";
import type { Moving, MovingFrame } from "../schema.ts";
import { emptySplats, type Splats } from "../splats.ts";
import { Bases } from "./bases.ts";
import { believed, guessed } from "./concealment.ts";
import { AFTER, BEFORE, BEGINS, ENDS, HEAD, MOVING, NUM_CHANNELS, STATE, TRACK } from "./layout.ts";
import { decodeMotion } from "./motion.ts";
import type { Poses } from "./poses.ts";
import { coefficients, coefficientsOf } from "./predict.ts";
import type { ClipInfo } from "./side_info.ts";
import type { Timeline } from "./timeline.ts";
import { move, offsetsOf, unitsOf } from "./trajectories.ts";

/** A frame as it is drawn. */
export interface ClipFrame extends MovingFrame {
  /** Track of each. */
  readonly tracks: Int32Array;
}

/** Bytes of decoded motion that are kept: a short clip is decoded once. */
const ROOM = 192 << 20;
/** What becomes of tracks whose motion is lost. */
const CONCEALERS = ["motion", "hold", "drop"];

/** A packet of motion: heads, and offsets of its tracks. */
interface Decoded {
  readonly heads: Int32Array;
  readonly offsets: Float32Array;
}

/** What is known when a group ends, by slot. */
interface Memory {
  readonly group: number;
  readonly alive: Uint8Array;
  readonly guessed: Uint8Array;
  readonly offsets: Float32Array;
}

interface Concealed {
  /** Whose motion is a guess. */
  readonly concealed: Uint8Array;
}

interface Played extends Poses, Concealed {
  readonly group: number;
  readonly numBases: number;
  /** Whether tracks whose motion was lost are left out. */
  readonly left: boolean;
  readonly shown: (packet: Packet) => boolean;
  readonly concealer: string;
  readonly memory: Memory;
}

export class Clip implements Moving {
  readonly concealers = CONCEALERS;
  packets: Packet[] = [];
  late = 0;
  readonly bases: Bases;
  readonly #motion: Packet[][];
  /** Elements of each group that came. */
  readonly #came: number[];
  /** The first group whose motion is not forgotten. */
  #oldest = 0;
  readonly #units: Float64Array;
  #kept = 0;
  readonly #decoded = new Map<Packet, Decoded>();
  #played: Played | null = null;
  #before: Memory | null = null;

  /** `numBytes` of the stream are there. */
  constructor(
    public info: ClipInfo,
    public numBytes: number,
  ) {
    this.bases = new Bases(info);
    this.#motion = info.groups.map(() => []);
    this.#came = info.groups.map(() => 0);
    this.#units = unitsOf(info);
  }

  /** Goes on with a clip that has more groups by now. */
  grow(info: ClipInfo): void {
    this.info = info;
    this.bases.grow(info);
    for (let group = this.#motion.length; group < info.groups.length; group++) {
      this.#motion.push([]);
      this.#came.push(0);
    }
  }

  addBases(group: number, first: number, rows: Float64Array, corner: Float64Array, splats: Splats): void {
    this.#came[group] += splats.count;
    this.bases.add(first, rows, corner, splats);
  }

  addMotion(group: number, packet: Packet): void {
    this.#came[group] += packet.count;
    if (group < this.#oldest) return void this.late++;
    this.#motion[group].push(packet);
    this.packets.push(packet);
    this.numBytes += packet.payload.length;
    if (this.#played?.group === group) this.#played = null;
  }

  get times(): Timeline {
    return this.info.timeline;
  }

  get firstFrame(): number {
    const section = this.info.sections.get("first_frame");
    if (!section) return 0;
    const reader = new ByteReader(section, "section 'first_frame'"),
      number = reader.unsigned();
    reader.finish();
    return number;
  }

  get ready(): number {
    const { groups, timeline } = this.info,
      last = groups.length - 1,
      whole = this.#came[last] >= groups[last].births + groups[last].motions;
    return whole ? timeline.numFrames : last * timeline.groupFrames;
  }

  forget(number: number): number[] {
    const end = Math.floor(number / this.info.timeline.groupFrames),
      blocks = new Set<number>();
    for (; this.#oldest < end; this.#oldest++) {
      for (const packet of this.#motion[this.#oldest].splice(0)) {
        blocks.add(packet.block);
        this.#kept -= this.#decoded.get(packet)?.offsets.byteLength ?? 0;
        this.#decoded.delete(packet);
      }
    }
    if (blocks.size) this.packets = this.packets.filter(({ block }) => !blocks.has(block));
    return [...blocks];
  }

  /** Frames of a group. */
  framesOf(group: number): number {
    const { numFrames, groupFrames } = this.info.timeline;
    return Math.min(groupFrames, numFrames - group * groupFrames);
  }

  /** A frame; motion of packets that are not shown is concealed, as that of those that are not there. */
  frame(number: number, shown: (packet: Packet) => boolean, concealer = "motion"): ClipFrame {
    const group = Math.floor(number / this.info.timeline.groupFrames),
      { slots, begins, ends, offsets, concealed, left } = this.#play(group, shown, concealer),
      frames = this.framesOf(group),
      at = number - group * this.info.timeline.groupFrames,
      here = rowsWhere(slots.length, (n) => begins[n] <= at && at < ends[n] && !(left && concealed[n])),
      splats = emptySplats(here.length, this.info.bases.degree),
      tracks = new Int32Array(here.length);
    let guesses = 0;
    for (let to = 0; to < here.length; to++) {
      const n = here[to];
      move(this.bases.splats, slots[n], offsets, (n * frames + at) * NUM_CHANNELS, splats, to);
      tracks[to] = this.bases.tracks[slots[n]];
      guesses += concealed[n];
    }
    return { number, splats, tracks, concealed: guesses };
  }

  /** Decodes motion of the group that comes next, for so many milliseconds: it is asked for soon. */
  ahead(number: number, ms: number): void {
    const group = (Math.floor(number / this.info.timeline.groupFrames) + 1) % this.#motion.length,
      end = performance.now() + ms;
    for (const packet of this.#motion[group]) {
      if (performance.now() > end) return;
      this.#decode(group, packet);
    }
  }

  #play(group: number, shown: (packet: Packet) => boolean, concealer: string): Played {
    const played = this.#played;
    const same = played?.shown === shown && played.concealer === concealer && played.numBases === this.bases.count;
    if (same && played.group === group) return played;
    if (played && played.group !== group) this.#before = played.memory;
    const before = this.#before?.group === group - 1 ? this.#before : null,
      found = this.#conceal(group, this.#arrived(group, shown), before, shown, concealer);
    this.#played = found;
    return found;
  }

  /** What packets say of a group whose bases are all there, and whom they speak of. */
  #arrived(group: number, shown: (packet: Packet) => boolean): { poses: Poses; spoken: Uint8Array } {
    const { bases, info } = this,
      frames = this.framesOf(group),
      spoken = new Uint8Array(bases.count),
      found: Decoded[] = [];
    let rows = bases.count;
    this.#check(rows, frames);
    for (const packet of this.#motion[group].filter(shown)) {
      const decoded = this.#decode(group, packet);
      if (!decoded) continue;
      found.push(decoded);
      rows += packet.count;
      this.#check(rows, frames);
      const { heads } = decoded,
        last = HEAD * (packet.count - 1),
        end = Math.min(heads[last + TRACK] + heads[last + AFTER] + 1, info.numTracks);
      for (let track = Math.max(heads[TRACK] - heads[BEFORE], 0); track < end; track++)
        if (bases.slots[track] >= 0) spoken[bases.slots[track]] = 1;
    }
    return { poses: joined(found, bases.slots, bases.count, frames), spoken };
  }

  /** Throws where poses of so many tracks take too much for what arrived: twice, before and after concealment. */
  #check(rows: number, frames: number): void {
    checkMemory(rows * frames * NUM_CHANNELS * 8, this.numBytes, `the motion of ${rows} tracks`);
  }

  /** A packet of motion whose bases are all there; null where one is missing. */
  #decode(group: number, packet: Packet): Decoded | null {
    const { bases, info } = this,
      frames = this.framesOf(group),
      known = this.#decoded.get(packet);
    if (known) return known;
    const { heads, residuals, orders } = decodeMotion(
        packet.payload,
        info.models,
        packet.count,
        frames,
        info.groups[group].firstNew,
      ),
      slots = new Int32Array(packet.count);
    for (let i = 0; i < slots.length; i++) {
      slots[i] = bases.slots[heads[HEAD * i + TRACK]] ?? -1;
      if (slots[i] < 0) return null;
    }
    const decoded = { heads, offsets: this.#offsets(heads, residuals, orders, slots, frames) };
    this.#keep(packet, decoded);
    return decoded;
  }

  /** Keeps what was decoded, as long as there is room; the oldest goes first. */
  #keep(packet: Packet, decoded: Decoded): void {
    this.#decoded.set(packet, decoded);
    this.#kept += decoded.offsets.byteLength;
    for (const [oldest, { offsets }] of this.#decoded) {
      if (this.#kept <= ROOM || oldest === packet) return;
      this.#decoded.delete(oldest);
      this.#kept -= offsets.byteLength;
    }
  }

  #offsets(
    heads: Int32Array,
    residuals: Int32Array,
    orders: Int32Array,
    slots: Int32Array,
    frames: number,
  ): Float32Array {
    const { places, shifts } = this.bases,
      count = slots.length,
      own = new Float64Array(3 * count),
      steps = new Int32Array(NUM_CHANNELS * count),
      moving = new Uint8Array(count),
      size = frames * NUM_CHANNELS,
      offsets = new Float32Array(size * count);
    for (let i = 0; i < count; i++) {
      const slot = slots[i];
      for (let a = 0; a < 3; a++) own[3 * i + a] = places[3 * slot + a];
      for (let c = 0; c < NUM_CHANNELS; c++) steps[NUM_CHANNELS * i + c] = shifts[NUM_CHANNELS * slot + c];
      moving[i] = Number(heads[HEAD * i + STATE] === MOVING);
    }
    const found = coefficients(own, moving, steps, residuals, orders),
      row = coefficientsOf(orders);
    for (let i = 0; i < count; i++)
      if (moving[i]) offsetsOf(found, i * row, frames, orders, this.#units, offsets, i * size);
    return offsets;
  }

  /** Adds those whose motion is not there. */
  #conceal(
    group: number,
    { poses, spoken }: { poses: Poses; spoken: Uint8Array },
    before: Memory | null,
    shown: (packet: Packet) => boolean,
    concealer: string,
  ): Played {
    const { bases, info } = this,
      { firstNew, births, motions } = info.groups[group],
      frames = this.framesOf(group),
      first = group * info.timeline.groupFrames,
      size = frames * NUM_CHANNELS,
      lost: number[] = [];
    for (let slot = 0; slot < bases.count; slot++) {
      if (spoken[slot]) continue;
      const track = bases.tracks[slot],
        isNew = track >= firstNew && track < firstNew + births;
      const ended = (info.lifetimes.ends.get(track) ?? Infinity) <= first;
      if (!ended && (isNew || (before ? before.alive[slot] : track < firstNew))) lost.push(slot);
    }
    const found = extended(poses, lost, frames, motions > 0);
    lost.forEach((slot, n) => {
      const track = bases.tracks[slot],
        begin = track < firstNew ? 0 : (info.lifetimes.begins.get(track) ?? 0),
        row = poses.slots.length + n;
      found.begins[row] = Math.min(begin, frames - 1);
      found.ends[row] = Math.min((info.lifetimes.ends.get(track) ?? Infinity) - first, frames);
    });
    if (motions && lost.length) {
      const guesses = found.offsets.subarray(size * poses.slots.length);
      this.#guess(poses, lost, before, group, guesses, concealer === "motion");
    }
    const left = concealer === "drop" || (concealer === "motion" && lost.length > 0 && !this.#believed(poses, frames));
    return {
      ...found,
      left,
      group,
      shown,
      concealer,
      numBases: bases.count,
      memory: this.#remember(group, found, before, frames),
    };
  }

  #believed(poses: Poses, frames: number): boolean {
    return believed(poses, wholeOf(poses, frames), this.bases.splats.means, frames);
  }

  /** What tracks do whose motion was lost: as neighbours say, or what they did last. */
  #guess(
    poses: Poses,
    lost: readonly number[],
    before: Memory | null,
    group: number,
    out: Float32Array,
    moving: boolean,
  ): void {
    const { bases, info } = this,
      frames = this.framesOf(group),
      room = bases.count * NUM_CHANNELS,
      told = moving ? wholeOf(poses, frames) : new Int32Array(),
      unit = 2 ** (info.bases.sizeLog - info.bases.unit - 1),
      past = {
        splats: bases.splats,
        since: before ? widened(before.offsets, room) : new Float32Array(room),
        guessed: before?.guessed ?? null,
        together: this.#together(told.map((n) => poses.slots[n])),
        fresh: (slot: number) => bases.born[slot] === group,
        untold: (slot: number) => bases.born[slot] === group && !info.lifetimes.begins.get(bases.tracks[slot]),
        rounding: (slot: number) => unit * 2 ** bases.shifts[NUM_CHANNELS * slot],
      };
    out.set(guessed(poses, told, Int32Array.from(lost), past, frames));
  }

  /** Slots of tracks that were born in the group that most of some were. */
  #together(slots: Int32Array): Uint8Array {
    const { born, count } = this.bases,
      counts = new Int32Array(this.info.groups.length),
      found = new Uint8Array(count);
    for (const slot of slots) counts[born[slot]]++;
    const most = counts.indexOf(counts.reduce((a, b) => Math.max(a, b), 0));
    for (let slot = 0; slot < count; slot++) found[slot] = Number(born[slot] === most);
    return found;
  }

  #remember(
    group: number,
    { slots, ends, offsets, concealed }: Poses & Concealed,
    before: Memory | null,
    frames: number,
  ): Memory {
    const count = this.bases.count,
      last = before ? widened(before.offsets, count * NUM_CHANNELS) : new Float32Array(count * NUM_CHANNELS),
      alive = new Uint8Array(count),
      guessed = new Uint8Array(count);
    for (let n = 0; n < slots.length; n++) {
      if (ends[n] !== frames) continue;
      const slot = slots[n],
        end = (n * frames + frames - 1) * NUM_CHANNELS;
      alive[slot] = 1;
      guessed[slot] = concealed[n];
      for (let c = 0; c < NUM_CHANNELS; c++) last[slot * NUM_CHANNELS + c] = offsets[end + c];
    }
    return { group, alive, guessed, offsets: last };
  }
}

/** Tracks of all packets, of one that is there twice the first counts; with room for all of `most` behind them. */
function joined(found: readonly Decoded[], slotOf: Int32Array, most: number, frames: number): Poses {
  const size = frames * NUM_CHANNELS,
    seen = new Uint8Array(slotOf.length),
    slots = new Int32Array(most),
    begins = new Int32Array(most),
    ends = new Int32Array(most),
    all = new Float32Array(size * most);
  let rows = 0;
  for (const { heads, offsets } of found) {
    for (let i = 0; i < offsets.length / size; i++) {
      const slot = slotOf[heads[HEAD * i + TRACK]];
      if (seen[slot]) continue;
      seen[slot] = 1;
      slots[rows] = slot;
      begins[rows] = Math.min(Math.max(heads[HEAD * i + BEGINS], 0), frames - 1);
      ends[rows] = Math.min(Math.max(heads[HEAD * i + ENDS], begins[rows]), frames);
      all.set(offsets.subarray(i * size, (i + 1) * size), rows++ * size);
    }
  }
  return {
    slots: slots.subarray(0, rows),
    begins: begins.subarray(0, rows),
    ends: ends.subarray(0, rows),
    offsets: all.subarray(0, rows * size),
  };
}

/** With tracks that stay as they are for all frames behind them: whose motion is lost, or of whom nothing is said. */
function extended(poses: Poses, others: readonly number[], frames: number, lost: boolean): Poses & Concealed {
  const known = poses.slots.length,
    count = known + others.length,
    concealed = new Uint8Array(count).fill(Number(lost), known),
    slots = new Int32Array(poses.slots.buffer, 0, count),
    begins = new Int32Array(poses.begins.buffer, 0, count),
    ends = new Int32Array(poses.ends.buffer, 0, count).fill(frames, known),
    offsets = new Float32Array(poses.offsets.buffer, 0, count * frames * NUM_CHANNELS);
  slots.set(others, known);
  return { slots, begins, ends, offsets, concealed };
}

/** Rows for which something holds, ascending. */
function rowsWhere(count: number, holds: (row: number) => boolean): Int32Array {
  const found = new Int32Array(count);
  let some = 0;
  for (let n = 0; n < count; n++) if (holds(n)) found[some++] = n;
  return found.subarray(0, some);
}

function widened(old: Float32Array, length: number): Float32Array {
  const wider = new Float32Array(length);
  wider.set(old);
  return wider;
}

/** Rows of tracks that are there in the whole group. */
function wholeOf({ slots, begins, ends }: Poses, frames: number): Int32Array {
  return rowsWhere(slots.length, (n) => begins[n] === 0 && ends[n] === frames);
}
