// What the page and its worker say to one another.

import type { Viewpoint } from "../codec/decoder.ts";
import type { Splats } from "../codec/splats.ts";
import type { Counts } from "./events.ts";
import type { Session } from "./webtransport.ts";

export type ToWorker =
  | { kind: "open"; session: Session | null; name: string; file: string; bytes: Uint8Array<ArrayBuffer> | null }
  | { kind: "conceal"; concealer: string; dropped: number; seed: number; ask: number }
  | { kind: "digest" };

/** Facts of a stream that the panel shows. */
export interface Facts {
  readonly gaussians: number;
  readonly packets: number;
  readonly degree: number;
  readonly sizeLog: number;
  readonly background: readonly [number, number, number];
  readonly viewpoint: Viewpoint | null;
  readonly sideInfoBytes: number;
}

export type FromWorker =
  | { kind: "preview"; splats: Splats; background: readonly [number, number, number] }
  | { kind: "facts"; facts: Facts }
  | { kind: "splats"; splats: Splats }
  | { kind: "counts"; counts: Counts; decodeMs: number; corrupt: number }
  | { kind: "gains"; gains: Float32Array; ask: number; shownPackets: number }
  | { kind: "note"; text: string }
  | { kind: "finished"; text: string; complete: boolean }
  | { kind: "failed"; text: string }
  | { kind: "digest"; found: string; expected: string };
