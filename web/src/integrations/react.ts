"use client";

// `splatwire/react`: <Viewer>, a React component with the element's attributes and events as properties.

import { createElement, forwardRef, useEffect, useImperativeHandle, useLayoutEffect, useRef } from "react";

import "../index.ts";
import type { SplatWire } from "../page/element.ts";

/** Names of events by property. */
const EVENTS = {
  onProgress: "progress",
  onFirstPicture: "firstpicture",
  onCameraChange: "camerachange",
  onUpdate: "update",
  onUpdateMissed: "updatemissed",
  onLoad: "load",
  onLost: "lost",
  onError: "error",
} as const;

/** Listens before the element's first event. React 18 warns about layout effects on servers, where neither runs. */
const useEarlyEffect = typeof document === "undefined" ? useEffect : useLayoutEffect;

type Properties = Readonly<Record<string, unknown>>;

/** Types of its properties are in `types/react.d.ts`. */
export const Viewer = forwardRef<SplatWire>(({ children, className, autorotate, ...rest }: Properties, ref) => {
  const own = useRef<SplatWire>(null),
    listeners = Object.entries(EVENTS).flatMap(([property, event]) => {
      const listener = rest[property] as EventListener | undefined;
      return listener ? [[event, listener] as const] : [];
    });
  useImperativeHandle(ref, () => own.current as SplatWire);
  useEarlyEffect(() => {
    const element = own.current;
    for (const [event, listener] of listeners) element?.addEventListener(event, listener);
    return () => {
      for (const [event, listener] of listeners) element?.removeEventListener(event, listener);
    };
  });
  const attributes = Object.entries(rest).filter(([name]) => !(name in EVENTS)),
    speed = typeof autorotate === "boolean" ? (autorotate ? "" : null) : autorotate;
  return createElement(
    "splat-wire",
    { ...Object.fromEntries(attributes), class: className, autorotate: speed, ref: own },
    children,
  );
});
