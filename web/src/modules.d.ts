/** Module that starts the worker from embedded text or from a separate file (scripts/bundle.mjs). */
declare module "worker:receiver" {
  export default function start(): Worker;
  /** Error message if the browser does not start it and gives no reason. */
  export const notStarted: string;
}

/** Part of React that `integrations/react.ts` uses; React is not installed here. */
declare module "react" {
  interface Reference<T> {
    current: T | null;
  }
  export function createElement(type: string, properties: object, children: unknown): object;
  export function forwardRef<T>(
    render: (properties: Readonly<Record<string, unknown>>, ref: Reference<T> | null) => object,
  ): object;
  export function useEffect(effect: () => () => void): void;
  export function useLayoutEffect(effect: () => () => void): void;
  export function useImperativeHandle<T>(ref: Reference<T> | null, make: () => T): void;
  export function useRef<T>(value: null): Reference<T>;
}

/** Digest of the sources that a bundle was built from. Parts of different builds do not fit together. */
declare const BUILD: string;
/** True if the worker is a file of its own. */
declare const SEPARATE: boolean;
