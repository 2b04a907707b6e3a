// Defines the element, and that of lists of scenes.

import { SplatWire } from "./page/element.ts";
import { Thumbnail } from "./page/thumbnail.ts";

if (!customElements.get("splat-wire")) customElements.define("splat-wire", SplatWire);
if (!customElements.get("splat-wire-preview")) customElements.define("splat-wire-preview", Thumbnail);
