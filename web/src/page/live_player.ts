// Player of live clips with a jitter buffer.

import { JitterBuffer } from "../jitter_buffer.ts";
import { PlayerBase, type RequestFrame } from "./player.ts";

export class LivePlayer extends PlayerBase {
  readonly #buffer: JitterBuffer;
  #firstPlayable = 0;
  /** True if playing at the last tick. Frames that pass during a pause are not counted as late. */
  #wasPlaying = false;

  constructor(rate: number, requestFrame: RequestFrame) {
    super(rate, requestFrame);
    this.number = -1;
    this.#buffer = new JitterBuffer(rate);
    this.begin();
  }

  /** Statistics for the panel: late frames, stalled frames, delay in seconds. */
  get statistics(): { late: number; stalled: number; buffer: number } {
    return { late: this.skipped, stalled: Math.round(this.#buffer.stalledFrames), buffer: this.#buffer.delaySeconds };
  }

  override get hasEnded(): boolean {
    return this.#buffer.ended && this.number >= this.#buffer.last; // also if there never was a frame
  }

  /** Pauses, or continues at the live position. */
  override play(playing: boolean): void {
    super.play(playing);
    this.#showStatus();
  }

  /** Announces playable frames. */
  playable(begin: number, end: number): void {
    this.#firstPlayable = begin;
    this.#buffer.add(begin, end, performance.now() / 1000);
    this.tick();
  }

  /** Announces the end of the clip. */
  end(): void {
    this.#buffer.ended = true;
    this.tick();
    this.#showStatus();
  }

  override shown(number: number): void {
    super.shown(number);
    this.#showStatus();
  }

  #showStatus(): void {
    this.button.hidden = this.hasEnded;
    const state = this.hasEnded ? "ended" : this.playing ? "live" : "paused";
    this.label.textContent = state + (this.number < 0 ? "" : `, frame ${this.number + 1}`);
  }

  protected override next(): number | null {
    const due = this.playing || this.number < 0 ? this.#buffer.due(performance.now() / 1000) : this.number;
    if (due === null || due < this.#firstPlayable) return null;
    if (this.#wasPlaying) this.skipped += Math.max(due - this.number - 1, 0);
    this.#wasPlaying = this.playing;
    return Math.max(due, this.number); // the clock may go back slightly
  }
}
