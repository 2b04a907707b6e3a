// Messages between the page and its worker.

import type { BoundingSphere, Viewpoint } from "../codec/decoder.ts";
import type { Texts } from "../codec/metadata.ts";
import type { Camera } from "../model/camera.ts";
import type { Packed, Tile } from "../render/packed.ts";
import type { PackedPreview } from "../render/packed_preview.ts";
import type { Counts } from "./events.ts";
import type { LossSimulation } from "./losses.ts";
import type { SessionAddress } from "./webtransport.ts";

export type ToWorker =
  | { kind: "open"; session: SessionAddress | null; name: string; file: string; bytes: Uint8Array<ArrayBuffer> | null }
  | { kind: "conceal"; simulation: LossSimulation; requestId: number }
  /** `budget` is the maximum number of drawn Gaussians of a scene with levels. */
  | { kind: "view"; camera: Camera; budget: number; requestId: number }
  /** Requests a frame of a clip, counted from the clip's first frame. Answered by `frame`. */
  | { kind: "frame"; number: number; simulation: LossSimulation }
  | { kind: "digest" }
  /** Requests updates of the scene at the location of its file, once it is complete; ends that if `file` is empty. */
  | { kind: "follow"; file: string };

/** Properties of a stream. */
export interface StreamInfo {
  /**
   * Number of elements: Gaussians or anchors; in a clip, keyframe Gaussians and, for each group, tracks with motion.
   * In a scene with levels, those of the coarsest tiles.
   */
  readonly numElements: number;
  readonly packets: number;
  readonly degree: number;
  /** True if the Gaussians depend on the camera, which the page must then report. */
  readonly viewDependent: boolean;
  /** Size of the scene and its centre, world units; `middle` is null if unknown before the first packet. */
  readonly size: number;
  readonly middle: readonly number[] | null;
  readonly background: readonly [number, number, number];
  readonly viewpoint: Viewpoint | null;
  /** Sphere around all frames of a clip, world units; null if the stream has none. */
  readonly extent: BoundingSphere | null;
  /** True if opacity decreases for Gaussians below the size of a pixel. */
  readonly antialiased: boolean;
  /** Up axis of the scene; null if the stream has none. */
  readonly up: string | null;
  /** Title, author and license; each is empty if the stream does not have it. */
  readonly texts: Texts;
  /** World coordinates that positions are relative to; 0, 0, 0 unless the scene is georeferenced. */
  readonly origin: readonly [number, number, number];
  readonly sideInfoBytes: number;
  /** Names of the available concealers. */
  readonly concealers: readonly string[];
  /** Frame rate, number of frames, and true for live clips; null for static scenes. */
  readonly sequence: { readonly rate: number; readonly numFrames: number; readonly live: boolean } | null;
}

export type FromWorker =
  | ({ kind: "preview" } & PackedPreview)
  | { kind: "info"; info: StreamInfo }
  /**
   * Gaussians for the page. `replaceAll`: replaces all earlier ones. `hasNew`: some are of packets not shown
   * before. `elements`: number of elements shown so far. `copies`: number of redundant Gaussians sent so far.
   * `gainsWithoutCopies`: gains that hide the redundant Gaussians, or null. `requestId`: number of the view request.
   */
  | {
      kind: "splats";
      packed: Packed;
      replaceAll: boolean;
      hasNew: boolean;
      elements: number;
      copies: number;
      gains: Float32Array | null;
      gainsWithoutCopies: Float32Array | null;
      requestId: number;
    }
  /** Tile replacements of a scene with levels. Other fields as in `splats`. */
  | { kind: "tiles"; removed: readonly number[]; added: readonly Tile[]; hasNew: boolean; requestId: number }
  /**
   * A frame, which replaces the one before. `numConcealed` is the number of tracks with estimated motion, `numKept`
   * the number of motion packets that simulated losses leave. `antialiased` is as in `StreamInfo`; it may change in
   * live clips.
   */
  | {
      kind: "frame";
      number: number;
      packed: Packed;
      antialiased: boolean;
      numConcealed: number;
      numKept: number;
      frameMs: number;
    }
  /**
   * Gaussians that determine the default viewpoint of a clip or of a scene with levels. Sent once they are complete.
   * Live clips have none.
   */
  | { kind: "framing"; packed: Packed }
  /**
   * Playable frames of a live clip, counted from its first frame. `late` is the number of packets that arrived after
   * their group was shown.
   */
  | { kind: "playable"; begin: number; end: number; late: number }
  /** `droppedGroups` is the number of groups of a live clip's current period that a device too slow for it dropped. */
  | { kind: "counts"; counts: Counts; decodeMs: number; corrupt: number; droppedGroups: number }
  /**
   * Update of the scene: indices of the Gaussians to hide, new ones to append, and the number of Gaussians afterwards.
   * `hidden` is null if `packed` replaces all Gaussians.
   */
  | { kind: "update"; hidden: Int32Array | null; packed: Packed; numRemoved: number; numNew: number; gaussians: number }
  /** An update was not applied: the scene stays as it was. */
  | { kind: "updatemissed"; reason: string }
  /** Gains under simulated losses, which leave `numKept` packets. */
  | {
      kind: "gains";
      gains: Float32Array;
      gainsWithoutCopies: Float32Array | null;
      requestId: number;
      numKept: number;
    }
  | { kind: "note"; text: string }
  /** End of the transfer: `complete`, `sent`, `stopped`, or a reason in words. */
  | { kind: "finished"; outcome: string; complete: boolean }
  | { kind: "failed"; text: string }
  /** Disconnect: its reason, and the time until the next attempt in milliseconds. */
  | { kind: "disconnect"; reason: string; retryMs: number }
  /** Result of the digest check. Sent without a request once the stream is complete. */
  | { kind: "digest"; isVerified: boolean };
