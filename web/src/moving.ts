// What a worker hands over of what moves: frames of a clip, or of the chapters of a live one.

import type { MovingFrame } from "./codec/schema.ts";
import type { Head } from "./packets/container.ts";
import type { Packet } from "./packets/packet.ts";
import { buffersOf, pack } from "./render/packed.ts";
import { Chapters } from "./transport/chapters.ts";
import { type Choice, shownPackets } from "./transport/losses.ts";
import type { FromWorker, ToWorker } from "./transport/messages.ts";
import type { Received } from "./transport/received.ts";

/** What a worker decodes of what comes next after each frame that it gave. */
const AHEAD_MS = 40;

type Say = (message: FromWorker, hand?: ArrayBuffer[]) => void;

export class Moving {
  /** Of a live clip. */
  #chapters: Chapters | null = null;
  #told = -1;
  #shown: { key: string; count: number; shown: (packet: Packet) => boolean } | null = null;

  constructor(readonly say: Say) {}

  /** Whether it is a live clip: there is no file of it, and nobody can have all of it. */
  get live(): boolean {
    return this.#chapters !== null;
  }

  /** A live clip begins, goes on with more groups, or with its next chapter. */
  follow(head: Head, received: Received, known: boolean): void {
    if (known && head.manifest.numPackets >= received.decoder.head.manifest.numPackets) received.decoder.grow(head);
    this.#chapters ??= new Chapters();
    if (!known) this.#chapters.follow(received);
  }

  /** Says which frames of a live clip can be shown, where it is news. */
  tellPlayable(): void {
    const playable = this.#chapters?.playable;
    if (!playable || playable.end === this.#told) return;
    this.#told = playable.end;
    this.say({ kind: "playable", ...playable, late: this.#chapters!.late });
  }

  /** Hands over a frame, of `received` where there are no chapters; `size` is that of the scene that is drawn. */
  frame({ number, choice }: ToWorker & { kind: "frame" }, received: Received | null, size: number): void {
    const place = this.#chapters?.at(number),
      schema = (this.#chapters ? place?.received : received)?.decoder.schema,
      moving = schema?.moving;
    if (!schema || !moving) return;
    const began = performance.now(),
      own = place?.number ?? number,
      { shown, count } = this.#shownMotion(moving.packets, choice),
      frame = this.#frameOf(() => moving.frame(own, shown, choice.concealer));
    const packed = pack(frame ? [frame.splats] : [], schema.degree, size),
      drawMs = performance.now() - began;
    this.say(
      { kind: "frame", number, packed, concealed: frame?.concealed ?? 0, shownPackets: count, drawMs },
      buffersOf(packed),
    );
    setTimeout(() => moving.ahead(own, AHEAD_MS));
  }

  /** A frame; null, which is said, where it takes too much memory. */
  #frameOf(make: () => MovingFrame): MovingFrame | null {
    try {
      return make();
    } catch (error) {
      this.say({ kind: "note", text: `This frame cannot be shown: ${(error as Error).message}.` });
      return null;
    }
  }

  /** Which packets of motion are shown: the same function for the same choice and packets. */
  #shownMotion(packets: readonly Packet[], choice: Choice): { shown: (packet: Packet) => boolean; count: number } {
    const last = packets.at(-1),
      key = JSON.stringify([packets.length, last?.block, last?.lane, { ...choice, concealer: "" }]);
    if (this.#shown?.key !== key) {
      const kept = shownPackets(packets, choice),
        some = new Set(packets.filter((_, n) => kept[n]));
      this.#shown = { key, count: some.size, shown: (packet) => some.has(packet) };
    }
    return this.#shown;
  }
}
