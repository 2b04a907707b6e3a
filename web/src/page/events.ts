// What an element tells the page around it.

/** What arrived, and how it ended. Times are milliseconds since the element began with its stream. */
export interface Status {
  /** When it began, milliseconds since navigation. */
  readonly began: number;
  /** The words for how it ended; null as long as it goes on. */
  finished: string | null;
  /** Why it cannot go on; null where it can. */
  failed: string | null;
  /** Why the link dropped; null while there is one. */
  lost: string | null;
  /** Whether every packet is there. */
  complete: boolean;
  /** Whether all decoded integers are those that were encoded; null as long as that is not known. */
  verified: boolean | null;
  gaussians: number;
  packets: number;
  expected: number;
  way: string;
  /** Time that the worker spent on decoding. */
  decodeMs: number;
  /** Preview, first Gaussians and half of them on the screen. */
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
  way: "",
  decodeMs: 0,
  times: {},
});

export interface Details {
  /** Packets and bytes so far, packets of the whole stream, and Gaussians that are drawn. */
  progress: { packets: number; expected: number; bytes: number; gaussians: number };
  /** There is something to see: milliseconds since the element began, and whether it is a preview. */
  firstpicture: { ms: number; preview: boolean };
  /** The transfer has ended: whether everything is there, and is what was encoded. */
  load: { complete: boolean; verified: boolean };
  /** It cannot go on. */
  error: { message: string };
  /** The link dropped; it is tried again after so many milliseconds. */
  lost: { reason: string; retryMs: number };
}

/** The events of the element by name. */
export type SplatWireEvents = { [Name in keyof Details]: CustomEvent<Details[Name]> };

/** Those and the standard events of an element; `load`, `error` and `progress` have the details above. */
export type SplatWireEventMap = Omit<HTMLElementEventMap, keyof SplatWireEvents> & SplatWireEvents;

export type Tell = <Name extends keyof Details>(name: Name, detail: Details[Name]) => void;
