// Periods of a live clip: the current one, and the one before until its last frame was shown.

import type { SequenceDecoder } from "../codec/element_decoder.ts";
import type { DecodedStream } from "./decoded_stream.ts";

/** Playable frames of a live clip, counted from its first frame. */
export interface Playable {
  /** First frame that may be shown: that of the group that was current at the start. */
  readonly begin: number;
  readonly end: number;
}

/** Frame of a period. */
export interface PeriodFrame {
  readonly stream: DecodedStream;
  readonly sequence: SequenceDecoder;
  readonly numberInPeriod: number;
}

export class Periods {
  #current: DecodedStream | null = null;
  #previous: DecodedStream | null = null;
  #begin = -1;
  #lateBefore = 0;

  /** Returns true if the frames of a stream follow those of the current period. */
  precede({ decoder }: DecodedStream): boolean {
    const before = this.#current!.decoder.elementDecoder.sequence!,
      { firstFrame, timeline } = decoder.elementDecoder.sequence!;
    return firstFrame >= before.firstFrame + before.timeline.numFrames && timeline.rate === before.timeline.rate;
  }

  /** Adds the next period. */
  addPeriod(stream: DecodedStream): void {
    this.#lateBefore += this.#previous?.decoder.elementDecoder.sequence?.numLatePackets ?? 0;
    this.#previous = this.#current;
    this.#current = stream;
  }

  /** Number of motion packets that arrived after their group was shown. */
  get late(): number {
    const late = (of: DecodedStream | null): number => of?.decoder.elementDecoder.sequence?.numLatePackets ?? 0;
    return this.#lateBefore + late(this.#previous) + late(this.#current);
  }

  get playable(): Playable | null {
    const sequence = this.#current?.decoder.elementDecoder.sequence;
    if (!sequence) return null;
    const { firstFrame, timeline, playableEnd } = sequence,
      newestGroupBegin = timeline.numFrames - 1 - ((timeline.numFrames - 1) % timeline.groupFrames);
    if (this.#begin < 0) this.#begin = firstFrame + newestGroupBegin;
    return { begin: this.#begin, end: Math.max(firstFrame + playableEnd, this.#begin) };
  }

  /** Returns the period of a frame, or the first later frame if its period was released. Releases earlier groups. */
  at(number: number): PeriodFrame | null {
    const current = this.#current,
      sequence = current?.decoder.elementDecoder.sequence,
      previous = this.#previous?.decoder.elementDecoder.sequence;
    if (!current || !sequence) return null;
    if (previous && previous.firstFrame <= number && number < sequence.firstFrame)
      return this.#periodFrame(this.#previous!, previous, number);
    this.#lateBefore += previous?.numLatePackets ?? 0;
    this.#previous = null;
    return this.#periodFrame(current, sequence, Math.max(number, sequence.firstFrame));
  }

  #periodFrame(stream: DecodedStream, sequence: SequenceDecoder, absolute: number): PeriodFrame {
    const numberInPeriod = Math.min(absolute - sequence.firstFrame, sequence.timeline.numFrames - 1);
    stream.decoder.intake.forget(sequence.forgetMotion(numberInPeriod));
    return { stream, sequence, numberInPeriod };
  }
}
