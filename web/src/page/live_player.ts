// The player of a live clip: a clock that runs behind what comes, by as much as its groups of late varied (a jitter
// buffer). What is not there when it is due is waited for while the last frame stays; what is late is left out.

import { AnyPlayer, type Asked } from "./player.ts";

/** Groups whose arrival the buffer goes by. */
const LOOKED_AT = 24;
/** Kept beyond the latest of those, seconds. */
const MARGIN_S = 0.03;
/** Share by which the clock runs faster where the buffer has more than it needs, and where it has much more. */
const CATCH_UP = 0.04,
  CATCH_UP_FAST = 0.15;
/** Surplus of the buffer from which the clock runs much faster, and from which it jumps, seconds. */
const MUCH_S = 0.5,
  JUMP_S = 1;
/**
 * Groups that have to come one after another at their rate before the clock jumps: an outage is over then. Each jump
 * doubles the number, so that a path that is late again and again is waited for.
 */
const CALM = 3;

/** When frames are shown, seconds in and out. */
export class JitterBuffer {
  /** When frame 0 would have been shown. */
  #zero = -Infinity;
  #end = -1;
  readonly #zeros: number[] = [];
  #at = 0;
  #cameAt = -Infinity;
  /** Groups that came at their rate, one after another. */
  #calm = 0;
  #calmNeeded = CALM;
  /** Frames that were due and not there. */
  held = 0;
  /** Whether no more will come. */
  over = false;

  constructor(readonly rate: number) {}

  /** Frames up to an end can be shown from now on. */
  add(begin: number, end: number, now: number): void {
    const first = Math.max(this.#end, begin);
    if (end <= first) return;
    this.#zeros.push(now - first / this.rate);
    if (this.#zeros.length > LOOKED_AT) this.#zeros.shift();
    this.#end = end;
    this.#jump((end - first) / this.rate, now);
    if (this.#zero === -Infinity) {
      this.#zero = this.#wanted;
      this.#at = now;
    }
  }

  /** Skips what an outage has delayed, once groups come at their rate and long before they are due. */
  #jump(seconds: number, now: number): void {
    this.#calm = now - this.#cameAt > seconds / 2 ? this.#calm + 1 : 0;
    this.#cameAt = now;
    if (this.#calm < this.#calmNeeded) return;
    const last = this.#zeros.slice(-this.#calm),
      wanted = Math.max(...last) + MARGIN_S;
    if (this.#zero - wanted < JUMP_S) return;
    this.#zeros.splice(0, this.#zeros.length - last.length);
    this.#zero = wanted;
    this.#calmNeeded = Math.min(2 * this.#calmNeeded, LOOKED_AT);
  }

  /** The last frame that can be shown. */
  get last(): number {
    return this.#end - 1;
  }

  get #wanted(): number {
    return Math.max(...this.#zeros) + MARGIN_S;
  }

  /** How long what comes waits, seconds. */
  get seconds(): number {
    return this.#zeros.length ? this.#zero - this.#zeros[this.#zeros.length - 1] : 0;
  }

  /** The frame to be shown now; null before the first. */
  due(now: number): number | null {
    if (this.#zero === -Infinity) return null;
    const passed = now - this.#at,
      wanted = this.#wanted;
    this.#at = now;
    if (wanted > this.#zero) this.#zero = wanted;
    else {
      const share = this.#zero - wanted > MUCH_S ? CATCH_UP_FAST : CATCH_UP;
      this.#zero = Math.max(wanted, this.#zero - share * passed);
    }
    const due = Math.floor((now - this.#zero) * this.rate);
    if (due < this.#end) return due < 0 ? null : due;
    if (!this.over) this.held += Math.min(passed * this.rate, due + 1 - this.#end);
    return this.last;
  }
}

export class LivePlayer extends AnyPlayer {
  readonly #buffer: JitterBuffer;
  #begin = 0;
  /** Whether it played when it last looked: what passes while it is paused is not late. */
  #goesOn = false;

  constructor(rate: number, ask: Asked) {
    super(rate, ask);
    this.number = -1;
    this.#buffer = new JitterBuffer(rate);
    this.begin();
  }

  /** What the panel says of it. */
  get facts(): { late: number; held: number; buffer: number } {
    return { late: this.skipped, held: Math.round(this.#buffer.held), buffer: this.#buffer.seconds };
  }

  override get over(): boolean {
    return this.#buffer.over && this.number === this.#buffer.last;
  }

  /** Holds the picture, or goes on with what is live then. */
  override play(playing: boolean): void {
    super.play(playing);
    this.#tell();
  }

  /** Frames that can be shown. */
  playable(begin: number, end: number): void {
    this.#begin = begin;
    this.#buffer.add(begin, end, performance.now() / 1000);
    this.tick();
  }

  /** No more will come. */
  end(): void {
    this.#buffer.over = true;
    this.tick();
    this.#tell();
  }

  override shown(number: number): void {
    super.shown(number);
    this.#tell();
  }

  #tell(): void {
    this.button.hidden = this.over;
    const how = this.over ? "ended" : this.playing ? "live" : "paused";
    this.told.textContent = how + (this.number < 0 ? "" : `, frame ${this.number + 1}`);
  }

  protected override next(): number | null {
    const due = this.playing || this.number < 0 ? this.#buffer.due(performance.now() / 1000) : this.number;
    if (due === null || due < this.#begin) return null;
    if (this.#goesOn) this.skipped += Math.max(due - this.number - 1, 0);
    this.#goesOn = this.playing;
    return Math.max(due, this.number); // the clock may go back a little
  }
}
