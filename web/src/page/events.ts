// Status and events of the element.

import type { Viewpoint } from "../codec/decoder.ts";

/** State of a transfer. Times are milliseconds since the element started its stream. */
export interface Status {
  /** Start time, milliseconds since navigation. */
  readonly began: number;
  /** Description of how the transfer ended; null while it continues. */
  finished: string | null;
  /** Error message; null without an error. */
  failed: string | null;
  /** Reason of a disconnect; null while connected. */
  lost: string | null;
  /** True if every packet was received. */
  complete: boolean;
  /** True if all decoded integers equal the encoded ones; null until it is known. */
  verified: boolean | null;
  gaussians: number;
  packets: number;
  expected: number;
  /** Transport of the packets: datagrams, HTTP or the cache of this browser. */
  transport: string;
  /** @deprecated Former name of `transport`. */
  way: string;
  /** Time for which the worker decoded packets as they arrived, milliseconds. Motion is decoded later, for drawing. */
  decodeMs: number;
  /** Times until the preview, the first Gaussians and half of them were on the screen. */
  times: Record<string, number>;
}

export const newStatus = (): Status => ({
  began: performance.now(),
  finished: null,
  failed: null,
  lost: null,
  complete: false,
  verified: null,
  gaussians: 0,
  packets: 0,
  expected: 0,
  transport: "",
  way: "",
  decodeMs: 0,
  times: {},
});

export interface Details {
  /** Received packets and bytes, packets of the whole stream, and drawn Gaussians. */
  progress: { packets: number; expected: number; bytes: number; gaussians: number };
  /** First picture: milliseconds since the start, and whether it is a preview. */
  firstpicture: { ms: number; preview: boolean };
  /** End of the transfer: whether it is complete, and whether its digest was verified. */
  load: { complete: boolean; verified: boolean };
  /** The element cannot continue, draws only in software, or the digest of the stream is wrong. */
  error: { message: string };
  /** The camera moved; at most once per animation frame. World units. */
  camerachange: Viewpoint;
  /** An update of the scene is on the screen: numbers of removed and new Gaussians, and of all Gaussians afterwards. */
  update: { removed: number; added: number; gaussians: number };
  /** An update was not applied, for this reason. The scene stays as it was, and the update is requested again. */
  updatemissed: { reason: string };
  /** Disconnect: its reason, and the time until the next attempt in milliseconds. */
  lost: { reason: string; retryMs: number };
}

/** Events of the element by name. */
export type SplatWireEvents = { [Name in keyof Details]: CustomEvent<Details[Name]> };

/** These and the standard events of an element. `load`, `error` and `progress` have the details above. */
export type SplatWireEventMap = Omit<HTMLElementEventMap, keyof SplatWireEvents> & SplatWireEvents;

export type Dispatch = <Name extends keyof Details>(name: Name, detail: Details[Name]) => void;
