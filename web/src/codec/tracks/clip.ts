// What of a clip arrived, and what it looks like in any frame. The twin of `splatwire.clips.decoding`.

import type { Packet } from "../../packets/packet.ts";
import type { Moving, MovingFrame } from "../schema.ts";
import { emptySplats, type Splats } from "../splats.ts";
import { Bases } from "./bases.ts";
import { addMoves, type Poses } from "./concealment.ts";
import { AFTER, BEFORE, BEGINS, ENDS, HEAD, MOVING, NUM_CHANNELS, STATE, TRACK } from "./layout.ts";
import { decodeMotion } from "./motion.ts";
import { coefficients } from "./predict.ts";
import type { ClipInfo, Timeline } from "./side_info.ts";
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

interface Played extends Poses {
  readonly group: number;
  readonly numBases: number;
  readonly shown: (packet: Packet) => boolean;
  readonly concealer: string;
  readonly concealed: Uint8Array;
  readonly memory: Memory;
}

export class Clip implements Moving {
  readonly concealers = CONCEALERS;
  readonly packets: Packet[] = [];
  readonly bases: Bases;
  readonly #motion: Packet[][];
  readonly #units: Float64Array;
  #kept = 0;
  readonly #decoded = new Map<Packet, Decoded>();
  #played: Played | null = null;
  #before: Memory | null = null;

  constructor(readonly info: ClipInfo) {
    this.bases = new Bases(info);
    this.#motion = info.groups.map(() => []);
    this.#units = unitsOf(info);
  }

  addBases(first: number, rows: Float64Array, corner: Float64Array, splats: Splats): void {
    this.bases.add(first, rows, corner, splats);
  }

  addMotion(group: number, packet: Packet): void {
    this.#motion[group].push(packet);
    this.packets.push(packet);
    if (this.#played?.group === group) this.#played = null;
  }

  get times(): Timeline {
    return this.info.timeline;
  }

  /** Frames of a group. */
  framesOf(group: number): number {
    const { numFrames, groupFrames } = this.info.timeline;
    return Math.min(groupFrames, numFrames - group * groupFrames);
  }

  /** A frame; motion of packets that are not shown is concealed, as that of those that are not there. */
  frame(number: number, shown: (packet: Packet) => boolean, concealer = "motion"): ClipFrame {
    const group = Math.floor(number / this.info.timeline.groupFrames),
      { slots, begins, ends, offsets, concealed } = this.#play(group, shown, concealer),
      frames = this.framesOf(group),
      at = number - group * this.info.timeline.groupFrames,
      left = concealer === "drop",
      here = Array.from(slots.keys()).filter((n) => begins[n] <= at && at < ends[n] && !(left && concealed[n])),
      splats = emptySplats(here.length, this.info.bases.degree);
    let guesses = 0;
    here.forEach((n, to) => {
      move(this.bases.splats, slots[n], offsets, (n * frames + at) * NUM_CHANNELS, splats, to);
      guesses += concealed[n];
    });
    return { number, splats, tracks: Int32Array.from(here, (n) => this.bases.tracks[slots[n]]), concealed: guesses };
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
    for (const packet of this.#motion[group].filter(shown)) {
      const decoded = this.#decode(group, packet);
      if (!decoded) continue;
      found.push(decoded);
      const { heads } = decoded,
        last = HEAD * (packet.count - 1),
        end = Math.min(heads[last + TRACK] + heads[last + AFTER] + 1, info.numTracks);
      for (let track = Math.max(heads[TRACK] - heads[BEFORE], 0); track < end; track++)
        if (bases.slots[track] >= 0) spoken[bases.slots[track]] = 1;
    }
    return { poses: joined(found, bases.slots, frames), spoken };
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
      slots = Int32Array.from({ length: packet.count }, (_, i) => bases.slots[heads[HEAD * i + TRACK]] ?? -1);
    if (slots.some((slot) => slot < 0)) return null;
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
      moving = Uint8Array.from({ length: count }, (_, i) => Number(heads[HEAD * i + STATE] === MOVING)),
      size = frames * NUM_CHANNELS,
      offsets = new Float32Array(size * count);
    slots.forEach((slot, i) => {
      own.set(places.subarray(3 * slot, 3 * slot + 3), 3 * i);
      steps.set(shifts.subarray(NUM_CHANNELS * slot, NUM_CHANNELS * (slot + 1)), NUM_CHANNELS * i);
    });
    const found = coefficients(own, moving, steps, residuals, orders);
    for (let i = 0; i < count; i++)
      if (moving[i]) offsetsOf(found, i * size, frames, orders, this.#units, offsets, i * size);
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
      size = frames * NUM_CHANNELS,
      lost: number[] = [];
    for (let slot = 0; slot < bases.count; slot++) {
      const track = bases.tracks[slot],
        isNew = track >= firstNew && track < firstNew + births;
      if (!spoken[slot] && (isNew || (before ? before.alive[slot] : track < firstNew))) lost.push(slot);
    }
    const slots = Int32Array.from([...poses.slots, ...lost]),
      offsets = new Float32Array(size * slots.length);
    offsets.set(poses.offsets);
    if (motions)
      this.#guess(poses, lost, before, frames, offsets.subarray(poses.offsets.length), concealer === "motion");
    const found = {
      slots,
      offsets,
      begins: Int32Array.from([...poses.begins, ...lost.map(() => 0)]),
      ends: Int32Array.from([...poses.ends, ...lost.map(() => frames)]),
      concealed: Uint8Array.from(slots, (_, n) => Number(n >= poses.slots.length && motions > 0)),
    };
    return {
      ...found,
      group,
      shown,
      concealer,
      numBases: bases.count,
      memory: this.#remember(group, found, before, frames),
    };
  }

  /** From where they were, unless that is a guess itself: then from their bases. */
  #guess(
    poses: Poses,
    lost: readonly number[],
    before: Memory | null,
    frames: number,
    out: Float32Array,
    moving: boolean,
  ): void {
    const { bases } = this,
      size = frames * NUM_CHANNELS,
      none = new Float32Array(bases.count * NUM_CHANNELS),
      since = before ? widened(before.offsets, none.length) : none,
      whole = Int32Array.from(poses.slots.keys()).filter((n) => poses.begins[n] === 0 && poses.ends[n] === frames),
      known = lost.map((slot) => !moving || !before?.guessed[slot]);
    for (const certain of [true, false]) {
      const at = lost.flatMap((_, n) => (known[n] === certain ? [n] : [])),
        who = Int32Array.from(at, (n) => lost[n]),
        told = certain ? whole.filter((n) => !before?.guessed[poses.slots[n]]) : whole,
        start = certain || !told.length ? since : none,
        moves = new Float32Array(size * who.length);
      who.forEach((slot, n) => {
        for (let k = 0; k < size; k++) moves[n * size + k] = start[slot * NUM_CHANNELS + (k % NUM_CHANNELS)];
      });
      if (moving) addMoves(poses, told, who, start, bases.splats.means, frames, moves);
      at.forEach((n, m) => out.set(moves.subarray(m * size, (m + 1) * size), n * size));
    }
  }

  #remember(
    group: number,
    { slots, ends, offsets, concealed }: Poses & { concealed: Uint8Array },
    before: Memory | null,
    frames: number,
  ): Memory {
    const count = this.bases.count,
      last = before ? widened(before.offsets, count * NUM_CHANNELS) : new Float32Array(count * NUM_CHANNELS),
      alive = new Uint8Array(count),
      guessed = new Uint8Array(count);
    slots.forEach((slot, n) => {
      if (ends[n] !== frames) return;
      alive[slot] = 1;
      guessed[slot] = concealed[n];
      const end = (n * frames + frames - 1) * NUM_CHANNELS;
      last.set(offsets.subarray(end, end + NUM_CHANNELS), slot * NUM_CHANNELS);
    });
    return { group, alive, guessed, offsets: last };
  }
}

/** Tracks of all packets; of one that is there twice the first counts. */
function joined(found: readonly Decoded[], slotOf: Int32Array, frames: number): Poses {
  const size = frames * NUM_CHANNELS,
    seen = new Set<number>(),
    rows: { slot: number; begins: number; ends: number; offsets: Float32Array }[] = [];
  for (const { heads, offsets } of found) {
    for (let i = 0; i < offsets.length / size; i++) {
      const slot = slotOf[heads[HEAD * i + TRACK]],
        begins = Math.min(Math.max(heads[HEAD * i + BEGINS], 0), frames - 1),
        ends = Math.min(Math.max(heads[HEAD * i + ENDS], begins), frames);
      if (seen.has(slot)) continue;
      seen.add(slot);
      rows.push({ slot, begins, ends, offsets: offsets.subarray(i * size, (i + 1) * size) });
    }
  }
  const all = new Float32Array(size * rows.length);
  rows.forEach((row, n) => all.set(row.offsets, n * size));
  return {
    slots: Int32Array.from(rows, ({ slot }) => slot),
    begins: Int32Array.from(rows, ({ begins }) => begins),
    ends: Int32Array.from(rows, ({ ends }) => ends),
    offsets: all,
  };
}

function widened(old: Float32Array, length: number): Float32Array {
  const wider = new Float32Array(length);
  wider.set(old);
  return wider;
}
