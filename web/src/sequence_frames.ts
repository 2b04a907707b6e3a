// Frames of clips and live clips, decoded in the worker for the page.

import type { DecodedFrame } from "./codec/element_decoder.ts";
import { emptySplats } from "./codec/splats.ts";
import type { Head } from "./packets/container.ts";
import type { Packet } from "./packets/packet.ts";
import { bufferOf, pack } from "./render/packed.ts";
import type { DecodedStream } from "./transport/decoded_stream.ts";
import { keptPackets, type LossSimulation } from "./transport/losses.ts";
import type { FromWorker, ToWorker } from "./transport/messages.ts";
import { Periods } from "./transport/periods.ts";

/** Time for decoding following frames after each requested one, milliseconds. */
const PREFETCH_MS = 40;

type PostMessage = (message: FromWorker, transfer?: ArrayBuffer[]) => void;

export class SequenceFrames {
  /** Periods of a live clip; null for other clips. */
  #periods: Periods | null = null;
  #reportedEnd = -1;
  /** Filter of the motion packets for the last simulated losses, with their settings and packets. */
  #filter: {
    readonly packets: readonly Packet[];
    readonly key: string;
    readonly count: number;
    readonly isKept: (packet: Packet) => boolean;
  } | null = null;

  constructor(readonly post: PostMessage) {}

  /**
   * True for live clips. They have no last packet, and no file while they run; a server may later offer a file under
   * the same name.
   */
  get live(): boolean {
    return this.#periods !== null;
  }

  /**
   * Processes a new head of a live clip: its first one, one with more groups, or that of the next period. Returns true
   * if a clip begins: the first one, or that of a restarted server, which counts its frames from 0 again.
   */
  onLiveHead(head: Head, stream: DecodedStream, isSamePeriod: boolean): boolean {
    if (isSamePeriod && head.manifest.numPackets >= stream.decoder.head.manifest.numPackets) stream.decoder.grow(head);
    const begins = !this.#periods || (!isSamePeriod && !this.#periods.precede(stream));
    if (begins) this.clear();
    this.#periods ??= new Periods();
    if (!isSamePeriod) this.#periods.addPeriod(stream);
    return begins;
  }

  /** Forgets a live clip, because another stream has replaced it. */
  clear(): void {
    this.#periods = null;
    this.#reportedEnd = -1;
  }

  /** Sends the range of playable frames of a live clip if it changed. */
  reportPlayable(): void {
    const playable = this.#periods?.playable;
    if (!playable || playable.end === this.#reportedEnd) return;
    this.#reportedEnd = playable.end;
    this.post({ kind: "playable", ...playable, late: this.#periods!.late });
  }

  /** Sends a frame, taken from `stream` unless the clip is live. `size` is the size of the scene, world units. */
  frame({ number, simulation }: ToWorker & { kind: "frame" }, stream: DecodedStream | null, size: number): void {
    const periodFrame = this.#periods?.at(number),
      decoder = (this.#periods ? periodFrame?.stream : stream)?.decoder,
      sequence = decoder?.elementDecoder.sequence;
    if (!decoder || !sequence) return;
    const began = performance.now(),
      numberInPeriod = periodFrame?.numberInPeriod ?? number,
      { isKept, count } = this.#motionFilter(sequence.packets, simulation),
      frame = this.#frameOf(() => sequence.frame(numberInPeriod, isKept, simulation.concealer, true));
    const { antialiased, elementDecoder } = decoder,
      // The page ignores frames without Gaussians, because their packets have not arrived. An empty frame that has
      // arrived is sent as one invisible Gaussian.
      splats = frame?.isWhole && !frame.splats.count ? emptySplats(1, elementDecoder.degree) : frame?.splats,
      packed = pack(splats ? [splats] : [], elementDecoder.degree, size),
      frameMs = performance.now() - began;
    this.post(
      { kind: "frame", number, packed, antialiased, numConcealed: frame?.numConcealed ?? 0, numKept: count, frameMs },
      [bufferOf(packed)],
    );
    setTimeout(() => sequence.prefetch(numberInPeriod, PREFETCH_MS));
  }

  /** Returns a frame. Reports the error and returns null if the frame needs too much memory. */
  #frameOf(make: () => DecodedFrame): DecodedFrame | null {
    try {
      return make();
    } catch (error) {
      this.post({ kind: "note", text: `This frame cannot be shown: ${(error as Error).message}.` });
      return null;
    }
  }

  /**
   * Returns a filter of the motion packets that simulated losses leave. The same losses and packets give the same one.
   */
  #motionFilter(
    packets: readonly Packet[],
    simulation: LossSimulation,
  ): { isKept: (packet: Packet) => boolean; count: number } {
    const last = packets.at(-1),
      key = JSON.stringify([packets.length, last?.block, last?.indexInBlock, { ...simulation, concealer: "" }]);
    if (this.#filter?.key !== key || this.#filter.packets !== packets) {
      const mask = keptPackets(packets, simulation),
        kept = new Set(packets.filter((_, n) => mask[n]));
      this.#filter = { packets, key, count: kept.size, isKept: (packet) => kept.has(packet) };
    }
    return this.#filter;
  }
}
