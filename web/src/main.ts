// Entry point of the page's bundle: defines the elements <splat-wire> and <splat-wire-preview>.

import { SplatWire } from "./page/element.ts";
import { Thumbnail } from "./page/thumbnail.ts";

// server-side rendering has no custom elements
const { customElements: registry } = globalThis as Partial<typeof globalThis>;
if (registry && !registry.get("splat-wire")) registry.define("splat-wire", SplatWire);
if (registry && !registry.get("splat-wire-preview")) registry.define("splat-wire-preview", Thumbnail);
