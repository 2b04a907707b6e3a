// Jitter buffer of live clips: the delay follows the recent variation of arrival times. A missing frame stalls
// playback; late frames are skipped.

/** Number of recent groups that determine the delay. */
const WINDOW_GROUPS = 24;
/** Margin after the most delayed of these groups, seconds. */
const MARGIN_S = 0.03;
/** Relative increase of the clock's speed while the delay is larger than needed, and while it is much larger. */
const SPEED_UP = 0.04,
  FAST_SPEED_UP = 0.15;
/** Surplus delay above which the clock runs much faster, and above which it jumps, seconds. */
const FAST_SURPLUS_S = 0.5,
  JUMP_SURPLUS_S = 1;
/**
 * Number of consecutive groups at the nominal rate that end an outage, after which the clock may jump. Each jump
 * doubles it, so that a path with repeated outages is not followed at once, until `CALM_GROUPS` groups in a row arrive
 * at the nominal rate and without an outage.
 */
const OUTAGE_END_GROUPS = 3,
  CALM_GROUPS = 120;

/** Jitter buffer: maps times in seconds to frames. */
export class JitterBuffer {
  /** Time at which frame 0 is due, seconds. */
  #frameZeroAt = -Infinity;
  #end = -1;
  /** For each recent group: when frame 0 would have been due if the group's first frame were due on its arrival. */
  readonly #frameZeroCandidates: number[] = [];
  /** Time of the last call of `due`, seconds. */
  #lastDueAt = 0;
  #arrivedAt = -Infinity;
  /** Number of consecutive groups that arrived at the nominal rate. */
  #steadyGroups = 0;
  #steadyGroupsNeeded = OUTAGE_END_GROUPS;
  /** Number of consecutive groups that arrived at the nominal rate and without an outage. */
  #calmGroups = 0;
  /** Number of frames that were due but missing. */
  stalledFrames = 0;
  /** True if no more frames will arrive. */
  ended = false;

  constructor(readonly rate: number) {}

  /** Records at time `now` that frames up to `end - 1` are playable. `begin` is the first frame of the visit. */
  add(begin: number, end: number, now: number): void {
    const first = Math.max(this.#end, begin);
    if (end <= first) return;
    this.#frameZeroCandidates.push(now - first / this.rate);
    if (this.#frameZeroCandidates.length > WINDOW_GROUPS) this.#frameZeroCandidates.shift();
    this.#end = end;
    this.#jump((end - first) / this.rate, now);
    if (this.#frameZeroAt === -Infinity) {
      this.#frameZeroAt = this.#wantedFrameZero;
      this.#lastDueAt = now;
    }
  }

  /** Skips the delay of an outage once groups arrive at the nominal rate and well before their due time. */
  #jump(nominalSeconds: number, now: number): void {
    this.#steadyGroups = now - this.#arrivedAt > nominalSeconds / 2 ? this.#steadyGroups + 1 : 0;
    this.#arrivedAt = now;
    // The groups of an outage arrive together, or are lost, and the first one after them is late.
    const [before, newest] = this.#frameZeroCandidates.slice(-2);
    this.#calmGroups = this.#steadyGroups && !(newest - before > JUMP_SURPLUS_S) ? this.#calmGroups + 1 : 0;
    if (this.#calmGroups >= CALM_GROUPS) this.#steadyGroupsNeeded = OUTAGE_END_GROUPS;
    if (this.#steadyGroups < this.#steadyGroupsNeeded) return;
    // Not all steady ones: if the groups of the outage are lost, all count as one, which arrived with a long delay.
    const last = this.#frameZeroCandidates.slice(-this.#steadyGroupsNeeded),
      wanted = Math.max(...last) + MARGIN_S;
    if (this.#frameZeroAt - wanted < JUMP_SURPLUS_S) return;
    this.#frameZeroCandidates.splice(0, this.#frameZeroCandidates.length - last.length);
    this.#frameZeroAt = wanted;
    this.#steadyGroupsNeeded = Math.min(2 * this.#steadyGroupsNeeded, WINDOW_GROUPS);
  }

  /** Last playable frame. */
  get last(): number {
    return this.#end - 1;
  }

  get #wantedFrameZero(): number {
    return Math.max(...this.#frameZeroCandidates) + MARGIN_S;
  }

  /** Current delay of the newest group, seconds. */
  get delaySeconds(): number {
    return this.#frameZeroCandidates.length
      ? this.#frameZeroAt - this.#frameZeroCandidates[this.#frameZeroCandidates.length - 1]
      : 0;
  }

  /** Returns the frame to show at time `now`; null before the first frame. */
  due(now: number): number | null {
    if (this.#frameZeroAt === -Infinity) return null;
    const passed = now - this.#lastDueAt,
      wanted = this.#wantedFrameZero;
    this.#lastDueAt = now;
    if (wanted > this.#frameZeroAt) this.#frameZeroAt = wanted;
    else {
      const share = this.#frameZeroAt - wanted > FAST_SURPLUS_S ? FAST_SPEED_UP : SPEED_UP;
      this.#frameZeroAt = Math.max(wanted, this.#frameZeroAt - share * passed);
    }
    const due = Math.floor((now - this.#frameZeroAt) * this.rate);
    if (due < this.#end) return due < 0 ? null : due;
    if (!this.ended) this.stalledFrames += Math.min(passed * this.rate, due + 1 - this.#end);
    return this.last;
  }
}
