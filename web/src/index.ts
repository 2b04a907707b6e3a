// `splatwire`: defines the element <splat-wire>.

import { SplatWire } from "./page/element.ts";

if (!customElements.get("splat-wire")) customElements.define("splat-wire", SplatWire);

export type { Details, SplatWireEvents, Status } from "./page/events.ts";
export { SplatWire };
