// The player of a clip: a clock that asks the worker for the frame that is due. What comes late is left out: nothing
// is asked for before the frame before is on the screen.

type Asked = (number: number) => void;

/** When frames of a clip are shown. */
export interface Times {
  readonly rate: number;
  readonly numFrames: number;
}

export class Player {
  readonly element = document.createElement("fieldset");
  readonly #button = document.createElement("button");
  readonly #seek = document.createElement("input");
  readonly #told = document.createElement("output");
  #playing = true;
  /** Time of the first frame, milliseconds. */
  #began = performance.now();
  #number = 0;
  #waiting = false;
  #stale = true;
  #ticking = 0;
  /** Frames that were due and not shown since it plays. */
  skipped = 0;

  constructor(
    readonly times: Times,
    readonly ask: Asked,
  ) {
    this.element.className = "player";
    this.element.setAttribute("aria-label", "player");
    this.#button.type = "button";
    this.#button.addEventListener("click", () => this.play(!this.#playing));
    this.#seek.type = "range";
    this.#seek.setAttribute("aria-label", "frame");
    this.#seek.max = String(times.numFrames - 1);
    this.#seek.addEventListener("input", () => this.seek(Number(this.#seek.value)));
    this.element.append(this.#button, this.#seek, this.#told);
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    this.#tick();
  }

  get number(): number {
    return this.#number;
  }

  get playing(): boolean {
    return this.#playing;
  }

  destroy(): void {
    clearTimeout(this.#ticking);
    this.element.remove();
  }

  play(playing: boolean): void {
    this.#playing = playing;
    this.#button.textContent = playing ? "pause" : "play";
    this.#began = performance.now() - (this.#number / this.times.rate) * 1000;
    if (playing) this.#tick();
  }

  /** Goes to a frame; it pauses there. */
  seek(number: number): void {
    this.#number = Math.min(Math.max(Math.round(number), 0), this.times.numFrames - 1);
    this.play(false);
    this.again();
  }

  /** The frame looks different now: packets came, or others are dropped. */
  again(): void {
    this.#stale = true;
    this.#tick();
  }

  /** A frame is on the screen. */
  shown(number: number): void {
    this.#waiting = false;
    this.#seek.value = String(number);
    this.#told.textContent = `frame ${number + 1} of ${this.times.numFrames}`;
    this.#tick();
  }

  #tick(): void {
    clearTimeout(this.#ticking);
    if (this.#playing) this.#ticking = window.setTimeout(() => this.#tick(), 1000 / this.times.rate / 2);
    if (this.#waiting) return;
    const { rate, numFrames } = this.times;
    if (this.#playing) {
      const due = Math.floor(((performance.now() - this.#began) / 1000) * rate) % numFrames,
        passed = (due - this.#number + numFrames) % numFrames;
      if (passed > 1) this.skipped += passed - 1;
      if (passed) this.#stale = true;
      this.#number = due;
    }
    if (!this.#stale) return;
    this.#stale = false;
    this.#waiting = true;
    this.ask(this.#number);
  }
}
