// Types of `splatwire/react`.

import type { CSSProperties, ForwardRefExoticComponent, ReactNode, RefAttributes } from "react";

import type { SplatWireAttributes } from "./frameworks.js";
import type { SplatWireEvents } from "./page/events.js";
import type { SplatWire } from "./page/element.js";

type Listener<Name extends keyof SplatWireEvents> = ((event: SplatWireEvents[Name]) => void) | undefined;

/** Attributes and events of the element (docs/browser.md), and the usual ones of an HTML element. */
export interface ViewerProps extends Omit<SplatWireAttributes, "autorotate"> {
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
  className?: string | undefined;
  style?: CSSProperties | undefined;
  id?: string | undefined;
  /** Hotspots. */
  children?: ReactNode;
}

/** `<splat-wire>` as a component of React 18 or 19. A reference to it is the element. */
export declare const Viewer: ForwardRefExoticComponent<ViewerProps & RefAttributes<SplatWire>>;
export type { SplatWire };
