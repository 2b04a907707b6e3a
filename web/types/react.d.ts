// Types of `splatwire/react`.

import type { ForwardRefExoticComponent, HTMLAttributes, RefAttributes } from "react";

import type { SplatWireAttributes } from "./frameworks.js";
import type { SplatWireEvents } from "./page/events.js";
import type { SplatWire } from "./page/element.js";

type Listener<Name extends keyof SplatWireEvents> = ((event: SplatWireEvents[Name]) => void) | undefined;

/** Attributes and events of the element (docs/browser.md). */
interface OwnProps extends Omit<SplatWireAttributes, "autorotate"> {
  /** Degrees per second; true means 12. */
  autorotate?: boolean | number | undefined;
  onProgress?: Listener<"progress">;
  onFirstPicture?: Listener<"firstpicture">;
  onCameraChange?: Listener<"camerachange">;
  onUpdate?: Listener<"update">;
  onUpdateMissed?: Listener<"updatemissed">;
  onLoad?: Listener<"load">;
  onLost?: Listener<"lost">;
  onError?: Listener<"error">;
}

/** Attributes and events of the element, and those of every HTML element. Children are hotspots. */
export interface ViewerProps extends OwnProps, Omit<HTMLAttributes<SplatWire>, keyof OwnProps> {}

/** `<splat-wire>` as a component of React 18 or 19. A reference to it is the element. */
export declare const Viewer: ForwardRefExoticComponent<ViewerProps & RefAttributes<SplatWire>>;
export type { SplatWire };
