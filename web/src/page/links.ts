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

export function embedCode(stream: string): string {
  const script = new URL("/splatwire.js", location.href).href,
    src = new URL(stream, document.baseURI).href;
  const element = `<splat-wire src="${src}" style="height: 30rem"></splat-wire>`;
  return `<script type="module" src="${script}"></script>\n${element}`;
}

/** Nine numbers: eye, the point that it looks at, what is up there; null where it is something else. */
export function viewpointOf(words: string | null): Viewpoint | null {
  const numbers = words?.trim().split(/\s+/).map(Number);
  if (numbers?.length !== 9 || !numbers.every(Number.isFinite)) return null;
  const [ex, ey, ez, tx, ty, tz, ux, uy, uz] = numbers;
  return { eye: [ex, ey, ez], target: [tx, ty, tz], up: [ux, uy, uz] };
}
