// Links to a view of the scene, and embed code for other pages.

import type { Viewpoint } from "../codec/decoder.ts";
import { uncachedUrl } from "../transport/http_file.ts";
import { addressOf } from "./address.ts";
import type { Settings } from "./panel.ts";

export interface Linked {
  readonly settings: Partial<Settings>;
  /** True if the scene is turned upside down. */
  readonly turned: boolean;
  /** Viewpoint of the link; null if it has none. */
  readonly viewpoint: Viewpoint | null;
}

/** Fields of a link. The up axis of the viewpoint replaces the former `turned`. */
const FIELDS = ["view-of", "concealer", "drop", "view", "turned"];

/** Splits a fragment into the route of an application, such as `#/rooms/3?`, and fields. */
function splitFragment(fragment: string): { readonly route: string; readonly fields: string } {
  if (!/^#!?\//.test(fragment)) return { route: "#", fields: fragment.slice(1) };
  const [route, ...fields] = fragment.split("?");
  return { route: `${route}?`, fields: fields.join("?") };
}

/** Returns what the page's address says about a scene. `name` tells the scenes of a page with several ones apart. */
export function readLink(name: string): Linked {
  const given = new URLSearchParams(splitFragment(location.hash).fields),
    fields = (given.get("view-of") ?? name) === name ? given : new URLSearchParams(),
    lossRate = Number(fields.get("drop") ?? 0),
    concealer = fields.get("concealer");
  const settings = { lossRate: lossRate > 0 && lossRate < 1 ? lossRate : 0, ...(concealer ? { concealer } : {}) };
  const viewpoint = viewpointOf((fields.get("view") ?? "").replaceAll(",", " "));
  return { settings, turned: fields.get("turned") === "1", viewpoint };
}

/** Significant digits of a viewpoint's numbers in a link. */
const DIGITS = 6;

/**
 * Returns a link to this page with the current view and settings. Other fields of the fragment and routes of an
 * application stay. `name` is that of the scene on a page with several ones, else null.
 */
export function writeLink({ concealer, lossRate }: Settings, viewpoint: Viewpoint, name: string | null): string {
  const address = new URL(location.href),
    { route, fields } = splitFragment(address.hash),
    others = fields.split("&").filter((field) => field && !FIELDS.includes(field.split("=")[0])),
    { eye, target, up } = viewpoint;
  const own = new URLSearchParams({
    ...(name === null ? {} : { "view-of": name }),
    concealer,
    drop: String(lossRate),
    view: [...eye, ...target, ...up].map((value) => Number(value.toPrecision(DIGITS))).join(),
  });
  address.hash = route + [...others, own.toString()].join("&");
  return address.href;
}

/** File that defines the element for pages without a bundler. Servers for development have another one of that name. */
const SCRIPT = /^(?!.*\/node_modules\/).*\/splatwire\.js$/;

/** Attributes of the element that change the picture. Embed code repeats them. */
export const EMBEDDED = ["up", "viewpoint", "concealer", "autorotate", "camera-limits", "updates"] as const;

/**
 * Returns embed code for another page. `attributes` are those of the element. Returns null if this script, loaded from
 * `own`, is part of an application's bundle or of a packed page, or if no other page can load the stream. Some bundlers
 * give no address or a path.
 */
export function embedCode(
  stream: URL,
  own: string | undefined,
  attributes: Readonly<Record<string, string>> = {},
): string | null {
  const script = addressOf(own ?? "");
  if (!script) return null;
  const { protocol, origin, pathname } = script,
    quoted = (text: string): string => text.replaceAll("&", "&amp;").replaceAll('"', "&quot;"),
    address = new URL(uncachedUrl(stream.href));
  if (![protocol, address.protocol].every((one) => /^https?:$/.test(one)) || !SCRIPT.test(pathname)) return null;
  const all = { src: address.href, ...attributes, style: "height: 30rem" },
    words = Object.entries(all).map(([name, value]) => ` ${name}="${quoted(value)}"`),
    tag = `<script type="module" src="${quoted(origin + pathname)}"></script>`;
  return `${tag}\n<splat-wire${words.join("")}></splat-wire>`;
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
