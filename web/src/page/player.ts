// Players of clips: a clock requests the frame that is due. With WebGL, the next frame is requested only once the last
// one is on the screen, so late frames are skipped; painting without WebGL does not hold it back.

import { createElement, iconButton, setIcon } from "./elements.ts";

export type RequestFrame = (frame: number) => void;

/** Timing of a clip. */
export interface SequenceTiming {
  readonly rate: number;
  readonly numFrames: number;
}

/** Base class of players: a button and the requested frame. */
export abstract class PlayerBase {
  readonly element = createElement("fieldset", { class: "player", part: "player", "aria-label": "player" });
  protected readonly button = iconButton("play", "play");
  protected readonly label = createElement("output");
  /** Frame that was requested last. */
  protected number = 0;
  #isPlaying = false;
  #isVisible = true;
  #waiting = false;
  #stale = true;
  #ticking = 0;
  /** Number of frames that were due during playback but not shown. */
  skipped = 0;

  constructor(
    readonly rate: number,
    readonly requestFrame: RequestFrame,
  ) {
    this.button.addEventListener("click", () => this.play(!this.#isPlaying));
    this.element.append(this.button, this.label);
  }

  /** Returns the frame to show; null if none is available. */
  protected abstract next(): number | null;

  /** True after `play(true)`, also while the element is invisible. */
  get started(): boolean {
    return this.#isPlaying;
  }

  /** Time of the frame that was requested last, seconds. */
  get time(): number {
    return Math.max(this.number, 0) / this.rate;
  }

  /** True while the clock runs. It stops while the element is invisible. */
  get playing(): boolean {
    return this.#isPlaying && this.#isVisible;
  }

  /** Sets whether the element is visible. */
  setVisible(seen: boolean): void {
    if (seen === this.#isVisible) return;
    this.#isVisible = seen;
    this.play(this.#isPlaying);
  }

  /** True after the last frame. */
  get hasEnded(): boolean {
    return false;
  }

  destroy(): void {
    this.#isPlaying = false; // a frame may still be announced
    clearTimeout(this.#ticking);
    this.element.remove();
  }

  /** Starts playing, or pauses if the visitor prefers reduced motion. */
  protected begin(): void {
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  play(playing: boolean): void {
    this.#isPlaying = playing;
    setIcon(this.button, playing ? "pause" : "play", playing ? "pause" : "play");
    this.tick();
  }

  /** Requests the current frame again, because packets arrived or the simulated losses changed. */
  redraw(): void {
    this.#stale = true;
    this.tick();
  }

  /** Announces that a frame is on the screen, or, without WebGL, that it was handed over for painting. */
  shown(_: number): void {
    this.#waiting = false;
    this.tick();
  }

  protected tick(): void {
    clearTimeout(this.#ticking);
    if (this.playing && !this.hasEnded) this.#ticking = window.setTimeout(() => this.tick(), 1000 / this.rate / 2);
    if (this.#waiting) return;
    const before = this.number,
      next = this.next();
    if (next === null || (next === before && !this.#stale)) return;
    this.number = next;
    this.#stale = false;
    this.#waiting = true;
    this.requestFrame(next);
  }
}

export class Player extends PlayerBase {
  readonly #seek = createElement("input", { type: "range", "aria-label": "frame" });
  /** Time of the first frame, milliseconds. */
  #began = 0;

  constructor(
    readonly times: SequenceTiming,
    requestFrame: RequestFrame,
  ) {
    super(times.rate, requestFrame);
    this.#seek.max = String(times.numFrames - 1);
    this.#seek.addEventListener("input", () => this.seek(Number(this.#seek.value)));
    this.label.before(this.#seek);
    this.begin();
  }

  override play(playing: boolean): void {
    this.#began = performance.now() - (this.number / this.rate) * 1000;
    super.play(playing);
  }

  /** Shows a frame and pauses. */
  seek(number: number): void {
    this.number = Math.min(Math.max(Math.round(number), 0), this.times.numFrames - 1);
    this.play(false);
    this.redraw();
  }

  override shown(number: number): void {
    this.#seek.value = String(number);
    this.label.textContent = `frame ${number + 1} of ${this.times.numFrames}`;
    super.shown(number);
  }

  protected override next(): number {
    if (!this.playing) return this.number;
    const { numFrames } = this.times,
      due = Math.floor(((performance.now() - this.#began) / 1000) * this.rate) % numFrames;
    this.skipped += Math.max(((due - this.number + numFrames) % numFrames) - 1, 0);
    return due;
  }
}
