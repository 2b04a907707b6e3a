// The player of a live clip: a clock that runs behind what comes, by as much as its groups of late varied (a jitter
// buffer). What is not there when it is due is waited for while the last frame stays; what is late is left out.

type Asked = (number: number) => void;

/** Groups whose arrival the buffer goes by. */
const LOOKED_AT = 24;
/** Kept beyond the latest of those, seconds. */
const MARGIN_S = 0.03;
/** So much faster or slower the clock runs where the buffer has more than it needs. */
const CATCH_UP = 0.04;

/** When frames are shown, seconds in and out. */
export class JitterBuffer {
  /** When frame 0 would have been shown. */
  #zero = -Infinity;
  #end = -1;
  readonly #zeros: number[] = [];
  #at = 0;
  /** Frames that were due and not there. */
  held = 0;

  constructor(readonly rate: number) {}

  /** Frames up to an end can be shown from now on. */
  add(begin: number, end: number, now: number): void {
    const first = Math.max(this.#end, begin);
    if (end <= first) return;
    this.#zeros.push(now - first / this.rate);
    if (this.#zeros.length > LOOKED_AT) this.#zeros.shift();
    this.#end = end;
    if (this.#zero === -Infinity) {
      this.#zero = this.#wanted;
      this.#at = now;
    }
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
    else this.#zero = Math.max(wanted, this.#zero - CATCH_UP * passed);
    const due = Math.floor((now - this.#zero) * this.rate);
    if (due < this.#end) return due < 0 ? null : due;
    this.held += passed * this.rate;
    return this.#end - 1;
  }
}

export class LivePlayer {
  readonly element = document.createElement("fieldset");
  readonly #button = document.createElement("button");
  readonly #told = document.createElement("output");
  readonly #buffer: JitterBuffer;
  #playing = true;
  #number = -1;
  #begin = 0;
  #waiting = false;
  #stale = false;
  #ticking = 0;
  /** Frames that were there, due, and not shown. */
  skipped = 0;

  constructor(
    readonly rate: number,
    readonly ask: Asked,
  ) {
    this.#buffer = new JitterBuffer(rate);
    this.element.className = "player";
    this.element.setAttribute("aria-label", "player");
    this.#button.type = "button";
    this.#button.addEventListener("click", () => this.play(!this.#playing));
    this.element.append(this.#button, this.#told);
    this.#told.textContent = "live";
    this.play(true);
  }

  get playing(): boolean {
    return this.#playing;
  }

  /** What the panel says of it. */
  get facts(): { late: number; held: number; buffer: number } {
    return { late: this.skipped, held: Math.round(this.#buffer.held), buffer: this.#buffer.seconds };
  }

  destroy(): void {
    clearTimeout(this.#ticking);
    this.element.remove();
  }

  /** Holds the picture, or goes on with what is live then. */
  play(playing: boolean): void {
    this.#playing = playing;
    this.#button.textContent = playing ? "pause" : "play";
    if (playing) this.#tick();
  }

  /** Frames that can be shown. */
  playable(begin: number, end: number): void {
    this.#begin = begin;
    this.#buffer.add(begin, end, performance.now() / 1000);
    this.#tick();
  }

  /** The frame looks different now: others are dropped. */
  again(): void {
    this.#stale = true;
    this.#tick();
  }

  /** A frame is on the screen. */
  shown(number: number): void {
    this.#waiting = false;
    this.#told.textContent = `live, frame ${number + 1}`;
    this.#tick();
  }

  #tick(): void {
    clearTimeout(this.#ticking);
    if (this.#playing) this.#ticking = window.setTimeout(() => this.#tick(), 1000 / this.rate / 2);
    if (this.#waiting) return;
    const due = this.#playing ? this.#buffer.due(performance.now() / 1000) : this.#number;
    if (due === null || due < this.#begin) return;
    if (due > this.#number + 1 && this.#number >= 0 && this.#playing) this.skipped += due - this.#number - 1;
    if (due === this.#number && !this.#stale) return;
    this.#number = Math.max(due, this.#number); // the clock may go back a little
    this.#stale = false;
    this.#waiting = true;
    this.ask(this.#number);
  }
}
