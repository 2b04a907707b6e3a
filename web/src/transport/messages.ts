// What the page and its worker say to one another.

import type { Ball, Viewpoint } from "../codec/decoder.ts";
import type { Camera } from "../model/camera.ts";
import type { Packed, Tile } from "../render/packed.ts";
import type { Counts } from "./events.ts";
import type { Choice } from "./losses.ts";
import type { Session } from "./webtransport.ts";

export type ToWorker =
  | { kind: "open"; session: Session | null; name: string; file: string; bytes: Uint8Array<ArrayBuffer> | null }
  | { kind: "conceal"; choice: Choice; ask: number }
  | { kind: "look"; camera: Camera; ask: number }
  /** A frame of what moves; answered by `frame`. */
  | { kind: "frame"; number: number; choice: Choice }
  | { kind: "digest" };

/** Facts of a stream that the panel shows. */
export interface Facts {
  readonly gaussians: number;
  readonly packets: number;
  readonly degree: number;
  /** Whether the page has to say where it looks from, and hears of other Gaussians then. */
  readonly viewDependent: boolean;
  /** Size of the scene, and its middle where it is known so early; world units. */
  readonly size: number;
  readonly middle: readonly number[] | null;
  readonly background: readonly [number, number, number];
  readonly viewpoint: Viewpoint | null;
  /** Where a clip goes; null where the stream does not say it. */
  readonly extent: Ball | null;
  /** Whether Gaussians lose opacity as they are widened to a pixel. */
  readonly antialiased: boolean;
  /** Which axis is up; null where the stream does not say it. */
  readonly up: string | null;
  readonly sideInfoBytes: number;
  /** Concealers that work on its elements. */
  readonly concealers: readonly string[];
  /** Frames a second and how many, of what moves, and whether it is live; null where all stands still. */
  readonly moving: { readonly rate: number; readonly numFrames: number; readonly live: boolean } | null;
}

export type FromWorker =
  | { kind: "preview"; packed: Packed; background: readonly [number, number, number] }
  | { kind: "facts"; facts: Facts }
  /**
   * Gaussians in addition to those that are there or, with their gains, instead of them; whether some of packets that
   * were not shown are among them; of how many elements there are some now; how many redundant Gaussians are among all
   * that were handed over; `lossless`: gains that hide those, null where there are none; `ask` is that of the look that
   * they are for.
   */
  | {
      kind: "splats";
      packed: Packed;
      instead: boolean;
      fresh: boolean;
      elements: number;
      copies: number;
      gains: Float32Array | null;
      lossless: Float32Array | null;
      ask: number;
    }
  /** Tiles of a scene with levels, in place of others; the rest as of `splats`. */
  | { kind: "tiles"; gone: readonly number[]; come: readonly Tile[]; fresh: boolean; ask: number }
  /** A frame of what moves, in place of what is there; how many elements are guesses, packets of motion are shown. */
  | { kind: "frame"; number: number; packed: Packed; concealed: number; shownPackets: number; drawMs: number }
  /** Which frames of a live clip can be shown by now, and how many packets came when their group had been shown. */
  | { kind: "playable"; begin: number; end: number; late: number }
  | { kind: "counts"; counts: Counts; decodeMs: number; corrupt: number }
  | { kind: "gains"; gains: Float32Array; lossless: Float32Array | null; ask: number; shownPackets: number }
  | { kind: "note"; text: string }
  | { kind: "finished"; text: string; complete: boolean }
  | { kind: "failed"; text: string }
  /** The link dropped, why, and when it is tried again. */
  | { kind: "lost"; reason: string; retryMs: number }
  /** Whether all integers that were decoded are those that were encoded; of a whole stream it is told unasked. */
  | { kind: "digest"; same: boolean };
