// Clocks of clips: the frame that is due at a time. Times are in seconds.

import { JitterBuffer } from "./jitter_buffer.ts";

/** Clock of a clip or of a live clip. */
export interface FrameClock {
  /** True after the last frame. */
  readonly ended: boolean;
  /** Announces that the first frame is on the screen. Before, the clock of a clip is paused. */
  start(now: number): void;
  play(now: number): void;
  pause(now: number): void;
  /** Sets the time of a clip, seconds, and pauses the clock until `play`. */
  seek(seconds: number): void;
  /** Returns the frame to show at time `now`; null before the first one. */
  due(now: number, loop: boolean): number | null;
  /** Announces playable frames of a live clip. */
  playable(begin: number, end: number, now: number): void;
  /** Announces that no more frames will arrive. */
  end(): void;
}

export class ClipClock implements FrameClock {
  ended = false;
  /** Time in the clip when it started to play, or while it is paused. */
  #time = 0;
  /** Time at which it started to play; null while it is paused. */
  #playedAt: number | null = null;
  #isStarted = false;

  constructor(readonly timing: { readonly rate: number; readonly numFrames: number }) {}

  start(now: number): void {
    if (this.#isStarted) return;
    this.#isStarted = true;
    if (this.#playedAt !== null) this.#playedAt = now;
  }

  play(now: number): void {
    this.#playedAt ??= now;
  }

  pause(now: number): void {
    this.#time = this.#timeAt(now);
    this.#playedAt = null;
  }

  seek(seconds: number): void {
    const { rate, numFrames } = this.timing;
    this.#time = Math.min(Math.max(seconds, 0), (numFrames - 1) / rate);
    this.#playedAt = null;
    this.ended = false;
  }

  due(now: number, loop: boolean): number {
    const { rate, numFrames } = this.timing,
      time = this.#timeAt(now),
      frame = Math.floor(time * rate + 1e-6); // a seek to n / rate shows frame n
    if (frame < numFrames) return frame;
    if (loop) {
      this.#time = time % (numFrames / rate);
      if (this.#playedAt !== null) this.#playedAt = now;
      return frame % numFrames;
    }
    this.ended = true;
    this.#time = (numFrames - 1) / rate;
    this.#playedAt = null;
    return numFrames - 1;
  }

  playable(): void {}

  end(): void {}

  #timeAt(now: number): number {
    return this.#time + (this.#playedAt === null || !this.#isStarted ? 0 : now - this.#playedAt);
  }
}

export class LiveClock implements FrameClock {
  readonly #buffer: JitterBuffer;
  #firstPlayable = 0;
  /** Frame of the last answer; -1 before the first one. */
  #last = -1;
  #isPlaying = false;

  constructor(rate: number) {
    this.#buffer = new JitterBuffer(rate);
  }

  get ended(): boolean {
    return this.#buffer.ended && this.#last >= this.#buffer.last; // also if there never was a frame
  }

  start(): void {}

  play(): void {
    this.#isPlaying = true;
  }

  pause(): void {
    this.#isPlaying = false;
  }

  seek(): void {}

  due(now: number): number | null {
    if (!this.#isPlaying && this.#last >= 0) return this.#last;
    const due = this.#buffer.due(now);
    if (due === null || due < this.#firstPlayable) return null;
    this.#last = Math.max(due, this.#last); // the clock may go back slightly
    return this.#last;
  }

  playable(begin: number, end: number, now: number): void {
    this.#firstPlayable = begin;
    this.#buffer.add(begin, end, now);
  }

  end(): void {
    this.#buffer.ended = true;
  }
}
