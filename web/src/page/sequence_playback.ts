// Playback of clips in the element: the player and its statistics in the panel.

import type { FromWorker, StreamInfo } from "../transport/messages.ts";
import { LivePlayer } from "./live_player.ts";
import type { Panel } from "./panel.ts";
import { Player, type RequestFrame } from "./player.ts";

/** Playback that was requested before a clip has arrived. */
export interface WantedPlayback {
  /** True to play, false to pause. */
  playing?: boolean | undefined;
  /** The same for live clips, which a request for a time does not pause. */
  playingLive?: boolean | undefined;
  /** Time of the clip, seconds. */
  time?: number | undefined;
}

export class SequencePlayback {
  #player: Player | LivePlayer | null = null;
  /** True if the stream is a still, which has no time. */
  #isStill = false;

  /** `panel` returns the panel, `requestFrame` requests a frame. */
  constructor(
    readonly panel: () => Panel,
    readonly requestFrame: RequestFrame,
    readonly wanted: WantedPlayback,
  ) {}

  /**
   * Creates a player for a stream. `seen` is true if the element is visible. A clip that replaces a playing one
   * plays, too.
   */
  begin(sequence: StreamInfo["sequence"], seen: boolean): void {
    const { wanted } = this,
      { time } = wanted,
      playing = (sequence?.live ? wanted.playingLive : wanted.playing) ?? this.#player?.started;
    wanted.playing = wanted.playingLive = wanted.time = undefined;
    this.#player?.destroy();
    this.#isStill = !sequence;
    this.#player =
      sequence &&
      (sequence.live ? new LivePlayer(sequence.rate, this.requestFrame) : new Player(sequence, this.requestFrame));
    if (!this.#player) return;
    this.panel().add(this.#player.element);
    this.#player.setVisible(seen);
    if (time !== undefined) this.seek(time);
    if (playing !== undefined) this.play(playing);
  }

  destroy(): void {
    this.#player?.destroy();
  }

  /** True if the stream is a clip. */
  get isSequence(): boolean {
    return this.#player !== null;
  }

  get live(): boolean {
    return this.#player instanceof LivePlayer;
  }

  setVisible(seen: boolean): void {
    this.#player?.setVisible(seen);
  }

  /** Starts or stops the playback. Before a clip arrives, the request is kept. Without effect on a still. */
  play(playing: boolean): void {
    if (this.#player) this.#player.play(playing);
    else if (!this.#isStill) Object.assign(this.wanted, { playing, playingLive: playing });
  }

  /** True if the clip does not play, and before it arrives, unless `play` was requested. A still does not play. */
  get paused(): boolean {
    return !(this.#player?.started ?? this.wanted.playing);
  }

  /** Time of the frame that was requested last, seconds; 0 for a still. */
  get currentTime(): number {
    return this.#player?.time ?? this.wanted.time ?? 0;
  }

  /**
   * Shows the frame at a time in seconds and pauses. Before a clip arrives, the request is kept. Without effect on
   * stills and live clips. Throws `TypeError` for NaN, as media elements do.
   */
  seek(seconds: number): void {
    if (Number.isNaN(seconds)) throw new TypeError("the time of a clip is a number");
    if (this.#player instanceof Player) this.#player.seek(seconds * this.#player.rate);
    if (this.#player || this.#isStill) return;
    Object.assign(this.wanted, { time: Math.max(seconds, 0), playing: false });
  }

  /** Duration in seconds; 0 for a still, infinite for a live clip. */
  get duration(): number {
    if (this.#player instanceof Player) return this.#player.times.numFrames / this.#player.rate;
    return this.#player ? Infinity : 0;
  }

  /** Redraws the current frame, which has changed. */
  redraw(): void {
    this.#player?.redraw();
  }

  /** Announces the end of a live clip. */
  end(): void {
    if (this.#player instanceof LivePlayer) this.#player.end();
  }

  /** Announces playable frames of a live clip. */
  playable({ begin, end, late }: FromWorker & { kind: "playable" }): void {
    if (!(this.#player instanceof LivePlayer)) return;
    this.#player.playable(begin, end);
    this.panel().setRow("late", `${late.toLocaleString()} packets, ${this.#player.statistics.late} frames`);
  }

  /** Shows a frame's statistics in the panel. */
  showStatistics({ numConcealed, numKept, frameMs }: FromWorker & { kind: "frame" }): void {
    const panel = this.panel();
    panel.setRow("motion concealed", numConcealed ? `${numConcealed.toLocaleString()} tracks` : "none");
    panel.setRow("motion shown", `${numKept.toLocaleString()} packets`);
    if (this.#player instanceof LivePlayer) {
      const { stalled, buffer } = this.#player.statistics;
      panel.setRow("stalled", stalled ? `${stalled} frames` : "none");
      panel.setRow("buffer", `${(1000 * buffer).toFixed(0)} ms`);
    } else panel.setRow("late", `${this.#player?.skipped ?? 0} frames`);
    panel.setRow("frame time", `${frameMs.toFixed(0)} ms`);
  }

  /** Announces that a frame is on the screen, so that the next one is requested. */
  shown(number: number): void {
    this.#player?.shown(number);
  }
}
