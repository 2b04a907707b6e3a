// Players of what moves: a clock that asks the worker for the frame that is due. What comes late is left out: nothing
// is asked for before the frame before is on the screen.

export type Asked = (number: number) => void;

/** When frames of a clip are shown. */
export interface Times {
  readonly rate: number;
  readonly numFrames: number;
}

/** What every player has: a button, and a frame that is asked for. */
export abstract class AnyPlayer {
  readonly element = document.createElement("fieldset");
  protected readonly button = document.createElement("button");
  protected readonly told = document.createElement("output");
  /** The frame that was asked for last. */
  protected number = 0;
  #wanted = false;
  #seen = true;
  #waiting = false;
  #stale = true;
  #ticking = 0;
  /** Frames that were due while it played, and not shown. */
  skipped = 0;

  constructor(
    readonly rate: number,
    readonly ask: Asked,
  ) {
    this.element.className = "player";
    this.element.setAttribute("aria-label", "player");
    this.button.type = "button";
    this.button.addEventListener("click", () => this.play(!this.#wanted));
    this.element.append(this.button, this.told);
  }

  /** The frame that should be on the screen; null where there is none. */
  protected abstract next(): number | null;

  /** Whether time passes: what nobody sees waits. */
  get playing(): boolean {
    return this.#wanted && this.#seen;
  }

  /** Whether somebody can see it. */
  sight(seen: boolean): void {
    if (seen === this.#seen) return;
    this.#seen = seen;
    this.play(this.#wanted);
  }

  /** Whether nothing is due any more. */
  get over(): boolean {
    return false;
  }

  destroy(): void {
    clearTimeout(this.#ticking);
    this.element.remove();
  }

  /** Begins as somebody wants who may not like motion. */
  protected begin(): void {
    this.play(!matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  play(playing: boolean): void {
    this.#wanted = playing;
    this.button.textContent = playing ? "pause" : "play";
    this.tick();
  }

  /** The frame looks different now: packets came, or others are dropped. */
  again(): void {
    this.#stale = true;
    this.tick();
  }

  /** A frame is on the screen. */
  shown(_: number): void {
    this.#waiting = false;
    this.tick();
  }

  protected tick(): void {
    clearTimeout(this.#ticking);
    if (this.playing && !this.over) this.#ticking = window.setTimeout(() => this.tick(), 1000 / this.rate / 2);
    if (this.#waiting) return;
    const before = this.number,
      next = this.next();
    if (next === null || (next === before && !this.#stale)) return;
    this.number = next;
    this.#stale = false;
    this.#waiting = true;
    this.ask(next);
  }
}

export class Player extends AnyPlayer {
  readonly #seek = document.createElement("input");
  /** Time of the first frame, milliseconds. */
  #began = 0;

  constructor(
    readonly times: Times,
    ask: Asked,
  ) {
    super(times.rate, ask);
    this.#seek.type = "range";
    this.#seek.setAttribute("aria-label", "frame");
    this.#seek.max = String(times.numFrames - 1);
    this.#seek.addEventListener("input", () => this.seek(Number(this.#seek.value)));
    this.told.before(this.#seek);
    this.begin();
  }

  override play(playing: boolean): void {
    this.#began = performance.now() - (this.number / this.rate) * 1000;
    super.play(playing);
  }

  /** Goes to a frame; it pauses there. */
  seek(number: number): void {
    this.number = Math.min(Math.max(Math.round(number), 0), this.times.numFrames - 1);
    this.play(false);
    this.again();
  }

  override shown(number: number): void {
    this.#seek.value = String(number);
    this.told.textContent = `frame ${number + 1} of ${this.times.numFrames}`;
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
