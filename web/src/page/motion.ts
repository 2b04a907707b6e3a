// What moves in an element: its player, and what the panel says of the frames.

import type { Facts, FromWorker } from "../transport/messages.ts";
import { LivePlayer } from "./live_player.ts";
import type { Panel } from "./panel.ts";
import { type Asked, Player } from "./player.ts";

export class Motion {
  #player: Player | LivePlayer | null = null;

  /** `panel` gives where it is told, `ask` hears of each frame that is due. */
  constructor(
    readonly panel: () => Panel,
    readonly ask: Asked,
  ) {}

  /** Begins with what a stream says of its motion; `seen` tells whether somebody can see it. */
  begin(moving: Facts["moving"], seen: boolean): void {
    this.#player?.destroy();
    this.#player = moving && (moving.live ? new LivePlayer(moving.rate, this.ask) : new Player(moving, this.ask));
    if (!this.#player) return;
    this.panel().add(this.#player.element);
    this.#player.sight(seen);
  }

  destroy(): void {
    this.#player?.destroy();
  }

  /** Whether anything moves. */
  get any(): boolean {
    return this.#player !== null;
  }

  get live(): boolean {
    return this.#player instanceof LivePlayer;
  }

  sight(seen: boolean): void {
    this.#player?.sight(seen);
  }

  /** The frame looks different now. */
  again(): void {
    this.#player?.again();
  }

  /** Nothing more comes of what is live. */
  end(): void {
    if (this.#player instanceof LivePlayer) this.#player.end();
  }

  /** Frames of a live clip can be shown. */
  playable({ begin, end, late }: FromWorker & { kind: "playable" }): void {
    if (!(this.#player instanceof LivePlayer)) return;
    this.#player.playable(begin, end);
    this.panel().tell("late", `${late.toLocaleString()} packets, ${this.#player.facts.late} frames`);
  }

  /** Says what a frame is made of. */
  tell({ concealed, shownPackets, drawMs }: FromWorker & { kind: "frame" }): void {
    const panel = this.panel();
    panel.tell("motion concealed", concealed ? `${concealed.toLocaleString()} tracks` : "none");
    panel.tell("motion shown", `${shownPackets.toLocaleString()} packets`);
    if (this.#player instanceof LivePlayer) {
      const { held, buffer } = this.#player.facts;
      panel.tell("held", held ? `${held} frames` : "none");
      panel.tell("buffer", `${(1000 * buffer).toFixed(0)} ms`);
    } else panel.tell("late", `${this.#player?.skipped ?? 0} frames`);
    panel.tell("a frame takes", `${drawMs.toFixed(0)} ms`);
  }

  /** A frame is on the screen: the next one is asked for. */
  shown(number: number): void {
    this.#player?.shown(number);
  }
}
