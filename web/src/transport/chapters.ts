// A live clip as its frames are counted: the chapter that comes, and the one before until its last frame was shown.

import type { Moving } from "../codec/schema.ts";
import type { Received } from "./received.ts";

/** What of a live clip can be shown, frames counted from its very first. */
export interface Playable {
  /** The first frame of all that may be shown: that of the group that ran when this began. */
  readonly begin: number;
  readonly end: number;
}

/** A chapter, and a frame of it. */
export interface Place {
  readonly received: Received;
  readonly moving: Moving;
  readonly number: number;
}

export class Chapters {
  #current: Received | null = null;
  #before: Received | null = null;
  #begin = -1;
  #lateBefore = 0;

  /** A chapter has begun. */
  follow(received: Received): void {
    this.#lateBefore += this.#before?.decoder.schema.moving?.late ?? 0;
    this.#before = this.#current;
    this.#current = received;
  }

  /** Packets of motion that came after their group was shown. */
  get late(): number {
    const late = (of: Received | null): number => of?.decoder.schema.moving?.late ?? 0;
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

  /** Where a frame is, or the next one where its chapter is gone. What comes before its group is forgotten. */
  at(number: number): Place | null {
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

  #place(received: Received, moving: Moving, absolute: number): Place {
    const number = Math.min(absolute - moving.firstFrame, moving.times.numFrames - 1);
    received.decoder.intake.forget(moving.forget(number));
    return { received, moving, number };
  }
}
