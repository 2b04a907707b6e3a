// Periods of a live clip: the current one, and the one before until its last frame was shown.

import type { SequenceDecoder } from "../codec/schema.ts";
import type { DecodedStream } from "./decoded_stream.ts";

/** Playable frames of a live clip, counted from its first frame. */
export interface Playable {
  /** First frame that may be shown: that of the group that was current at the start. */
  readonly begin: number;
  readonly end: number;
}

/** Frame of a period. */
export interface PeriodFrame {
  readonly received: DecodedStream;
  readonly moving: SequenceDecoder;
  readonly number: number;
}

export class Periods {
  #current: DecodedStream | null = null;
  #before: DecodedStream | null = null;
  #begin = -1;
  #lateBefore = 0;

  /** Adds the next period. */
  addPeriod(received: DecodedStream): void {
    this.#lateBefore += this.#before?.decoder.schema.moving?.late ?? 0;
    this.#before = this.#current;
    this.#current = received;
  }

  /** Number of motion packets that arrived after their group was shown. */
  get late(): number {
    const late = (of: DecodedStream | null): number => of?.decoder.schema.moving?.late ?? 0;
    return this.#lateBefore + late(this.#before) + late(this.#current);
  }

  get playable(): Playable | null {
    const moving = this.#current?.decoder.schema.moving;
    if (!moving) return null;
    const { firstFrame, times, ready } = moving,
      running = times.numFrames - 1 - ((times.numFrames - 1) % times.groupFrames);
    if (this.#begin < 0) this.#begin = firstFrame + running;
    return { begin: this.#begin, end: Math.max(firstFrame + ready, this.#begin) };
  }

  /** Returns the period of a frame, or the first later frame if its period was released. Releases earlier groups. */
  at(number: number): PeriodFrame | null {
    const current = this.#current,
      moving = current?.decoder.schema.moving,
      before = this.#before?.decoder.schema.moving;
    if (!current || !moving) return null;
    if (before && before.firstFrame <= number && number < moving.firstFrame)
      return this.#place(this.#before!, before, number);
    this.#lateBefore += before?.late ?? 0;
    this.#before = null;
    return this.#place(current, moving, Math.max(number, moving.firstFrame));
  }

  #place(received: DecodedStream, moving: SequenceDecoder, absolute: number): PeriodFrame {
    const number = Math.min(absolute - moving.firstFrame, moving.times.numFrames - 1);
    received.decoder.intake.forget(moving.forget(number));
    return { received, moving, number };
  }
}
