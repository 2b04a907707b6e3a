// `splatwire`: defines the element <splat-wire>.

import { SplatWire } from "./page/element.ts";

// server-side rendering has no custom elements
if (globalThis.customElements && !customElements.get("splat-wire")) customElements.define("splat-wire", SplatWire);

export type { Details, SplatWireEventMap, SplatWireEvents, Status } from "./page/events.ts";
export { SplatWire };
