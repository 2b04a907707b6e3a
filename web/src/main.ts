// Defines the element.

import { SplatWire } from "./page/element.ts";

if (!customElements.get("splat-wire")) customElements.define("splat-wire", SplatWire);
