// Types of <splat-wire> in templates of React, Preact, Solid, Svelte and Vue. None of them has to be installed.

import type { SplatWireEvents } from "./page/events.js";
import type { SplatWire } from "./page/element.js";

/** Attributes of the element, described in `docs/browser.md`. */
export interface SplatWireAttributes {
  src?: string | undefined;
  session?: string | undefined;
  fingerprint?: string | undefined;
  concealer?: string | undefined;
  /** Nine numbers: eye, target, up. */
  viewpoint?: string | undefined;
  up?: "x" | "-x" | "y" | "-y" | "z" | "-z" | undefined;
  panel?: "none" | "open" | undefined;
  gestures?: "cooperative" | undefined;
  /** Degrees per second; 12 for the empty string. */
  autorotate?: string | number | boolean | undefined;
  poster?: string | undefined;
  /** Four numbers: least and largest distance, world units, least and largest polar angle, degrees. */
  "camera-limits"?: string | undefined;
  "max-gaussians"?: number | string | undefined;
  updates?: "" | boolean | undefined;
}

/** Event listeners as `on...` attributes, for frameworks that support them. */
export type SplatWireListeners = {
  [Name in keyof SplatWireEvents as `on${Name}`]?: ((event: SplatWireEvents[Name]) => void) | undefined;
};

/** Event listeners as Vue and Solid have them: `onLoad`, `onFirstpicture`. */
type CapitalListeners = {
  [Name in keyof SplatWireEvents as `on${Capitalize<Name>}`]?: ((event: SplatWireEvents[Name]) => void) | undefined;
};
/** Event listeners as Solid and Svelte 4 have them: `on:load`. */
type NamespacedListeners = {
  [Name in keyof SplatWireEvents as `on:${Name}`]?: ((event: SplatWireEvents[Name]) => void) | undefined;
};
/** Listeners to events that HTML has, too: Preact finds them in any spelling. */
type PreactListeners = Pick<CapitalListeners, "onLoad" | "onError" | "onProgress">;

type Override<Known, Own> = Omit<Known, keyof Own> & Own;
/** React does not pass these events of a custom element to listeners in this spelling: use `onload`, or `Viewer`. */
type IgnoredByReact = { [Name in keyof PreactListeners]?: never };
type ReactProps = SplatWireProps & IgnoredByReact & { class?: string | undefined };
type SplatWireProps = SplatWireAttributes & SplatWireListeners;
/** Vue's type checker finds attributes under the names of properties. */
type VueProps = SplatWireAttributes &
  CapitalListeners & {
    cameraLimits?: SplatWireAttributes["camera-limits"];
    maxGaussians?: SplatWireAttributes["max-gaussians"];
  };
type SolidProps = SplatWireAttributes & CapitalListeners & NamespacedListeners;

// @ts-ignore: React is not installed
declare module "react" {
  namespace JSX {
    interface IntrinsicElements {
      // @ts-ignore: React is not installed
      "splat-wire": Override<DetailedHTMLProps<HTMLAttributes<SplatWire>, SplatWire>, ReactProps>;
    }
  }
}

// @ts-ignore: Preact is not installed
declare module "preact" {
  namespace JSX {
    interface IntrinsicElements {
      // @ts-ignore: Preact is not installed
      "splat-wire": Override<HTMLAttributes<SplatWire>, SplatWireProps & PreactListeners>;
    }
  }
}

// @ts-ignore: Solid is not installed
declare module "solid-js/jsx-runtime" {
  namespace JSX {
    interface IntrinsicElements {
      // @ts-ignore: Solid is not installed
      "splat-wire": Override<HTMLAttributes<SplatWire>, SolidProps>;
    }
  }
}

// @ts-ignore: Svelte is not installed
declare module "svelte/elements" {
  interface SvelteHTMLElements {
    // @ts-ignore: Svelte is not installed
    "splat-wire": Override<HTMLAttributes<SplatWire>, SplatWireProps & NamespacedListeners>;
  }
}

// @ts-ignore: Vue is not installed
declare module "vue" {
  interface GlobalComponents {
    // @ts-ignore: Vue is not installed. Its names are not in scope, because it exports them from another module.
    "splat-wire": new () => { $props: Override<import("vue").HTMLAttributes, VueProps> };
  }
}
