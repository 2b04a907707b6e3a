// What a link says behind its #, and code for other pages.

import type { Viewpoint } from "../codec/decoder.ts";
import type { Settings } from "./panel.ts";

export interface Linked {
  readonly settings: Partial<Settings>;
  /** Whether the scene was turned upside down. */
  readonly turned: boolean;
}

export function readLink(): Linked {
  const fields = new URLSearchParams(location.hash.slice(1)),
    dropped = Number(fields.get("drop") ?? 0),
    concealer = fields.get("concealer");
  const settings = { dropped: dropped > 0 && dropped < 1 ? dropped : 0, ...(concealer ? { concealer } : {}) };
  return { settings, turned: fields.get("turned") === "1" };
}

export function writeLink({ concealer, dropped }: Settings, turned: boolean): string {
  const address = new URL(location.href);
  address.hash = new URLSearchParams({
    concealer,
    drop: String(dropped),
    ...(turned ? { turned: "1" } : {}),
  }).toString();
  return address.href;
}

/** The file that defines the element for pages without a bundler. */
const SCRIPT = "/splatwire.js";

/**
 * Code for another page that shows a stream; null where this script, at the address `own`, is not that file but a part
 * of an application's bundle or of a packed page.
 */
export function embedCode(stream: URL, own: string): string | null {
  const { protocol, origin, pathname } = new URL(own),
    quoted = (address: string): string => address.replaceAll("&", "&amp;").replaceAll('"', "&quot;");
  if (!/^https?:$/.test(protocol) || !pathname.endsWith(SCRIPT)) return null;
  const element = `<splat-wire src="${quoted(stream.href)}" style="height: 30rem"></splat-wire>`;
  return `<script type="module" src="${quoted(origin + pathname)}"></script>\n${element}`;
}

/** Nine numbers: eye, the point that it looks at, what is up there; null where it is something else. */
export function viewpointOf(words: string | null): Viewpoint | null {
  const numbers = words?.trim().split(/\s+/).map(Number);
  if (numbers?.length !== 9 || !numbers.every(Number.isFinite)) return null;
  const [ex, ey, ez, tx, ty, tz, ux, uy, uz] = numbers;
  return { eye: [ex, ey, ez], target: [tx, ty, tz], up: [ux, uy, uz] };
}
