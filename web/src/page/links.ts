// Links to a view of the scene, and embed code for other pages.

import type { Viewpoint } from "../codec/decoder.ts";
import type { Settings } from "./panel.ts";

export interface Linked {
  readonly settings: Partial<Settings>;
  /** True if the scene is turned upside down. */
  readonly turned: boolean;
  /** Viewpoint of the link; null if it has none. */
  readonly viewpoint: Viewpoint | null;
}

export function readLink(): Linked {
  const fields = new URLSearchParams(location.hash.slice(1)),
    lossRate = Number(fields.get("drop") ?? 0),
    concealer = fields.get("concealer");
  const settings = { lossRate: lossRate > 0 && lossRate < 1 ? lossRate : 0, ...(concealer ? { concealer } : {}) };
  const viewpoint = viewpointOf((fields.get("view") ?? "").replaceAll(",", " "));
  return { settings, turned: fields.get("turned") === "1", viewpoint };
}

/** Significant digits of a viewpoint's numbers in a link. */
const DIGITS = 6;

/** Returns a link to this page with the current view and settings. Other fields of the fragment stay. */
export function writeLink({ concealer, lossRate }: Settings, viewpoint: Viewpoint): string {
  const address = new URL(location.href),
    fields = new URLSearchParams(address.hash.slice(1)),
    { eye, target, up } = viewpoint;
  fields.delete("turned"); // the up axis of the viewpoint says so
  fields.set("concealer", concealer);
  fields.set("drop", String(lossRate));
  fields.set("view", [...eye, ...target, ...up].map((value) => Number(value.toPrecision(DIGITS))).join());
  address.hash = fields.toString();
  return address.href;
}

/** File that defines the element for pages without a bundler. */
const SCRIPT = "/splatwire.js";

/** Query of a stream's URL on the servers of splatwire. It pins the current version, which caches keep for a year. */
const VERSION = /^\?[0-9a-f]{16}$/;

/** Attributes of the element that change the picture. Embed code repeats them. */
export const EMBEDDED = ["up", "viewpoint", "concealer", "autorotate", "camera-limits", "updates"] as const;

/**
 * Returns embed code for another page. `attributes` are those of the element. Returns null if this script, loaded from
 * `own`, is part of an application's bundle or of a packed page, or if no other page can load the stream.
 */
export function embedCode(stream: URL, own: string, attributes: Readonly<Record<string, string>> = {}): string | null {
  const { protocol, origin, pathname } = new URL(own),
    quoted = (text: string): string => text.replaceAll("&", "&amp;").replaceAll('"', "&quot;"),
    address = new URL(stream);
  if (![protocol, address.protocol].every((one) => /^https?:$/.test(one)) || !pathname.endsWith(SCRIPT)) return null;
  if (VERSION.test(address.search)) address.search = "";
  const all = { src: address.href, ...attributes, style: "height: 30rem" },
    words = Object.entries(all).map(([name, value]) => ` ${name}="${quoted(value)}"`),
    script = `<script type="module" src="${quoted(origin + pathname)}"></script>`;
  return `${script}\n<splat-wire${words.join("")}></splat-wire>`;
}

/** Parses this many finite numbers. Returns null for anything else. */
function numbersOf(words: string | null, count: number): number[] | null {
  const numbers = words?.trim().split(/\s+/).map(Number);
  return numbers?.length === count && numbers.every(Number.isFinite) ? numbers : null;
}

/** Parses camera limits: least and largest distance, least and largest angle. Returns null for anything else. */
export function limitsOf(words: string | null): number[] | null {
  const numbers = numbersOf(words, 4);
  return numbers && 0 <= numbers[0] && numbers[0] <= numbers[1] && numbers[2] <= numbers[3] ? numbers : null;
}

/** Largest coordinate of a viewpoint: squares of distances must be finite in single precision. */
const MAX_COORDINATE = 1e15;
/** Smallest length of an upward direction. */
const MIN_UP = 1e-6;

/**
 * Parses nine numbers: eye, target, up. Returns null for anything else, and if they are no view: the eye is the target,
 * the upward direction is 0, or a number is too large.
 */
export function viewpointOf(words: string | null): Viewpoint | null {
  const numbers = numbersOf(words, 9);
  if (!numbers?.every((number) => Math.abs(number) <= MAX_COORDINATE)) return null;
  const [ex, ey, ez, tx, ty, tz, ux, uy, uz] = numbers;
  if (!Math.fround(Math.hypot(ex - tx, ey - ty, ez - tz)) || Math.hypot(ux, uy, uz) < MIN_UP) return null;
  return { eye: [ex, ey, ez], target: [tx, ty, tz], up: [ux, uy, uz] };
}
