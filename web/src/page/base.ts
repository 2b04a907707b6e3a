// Base class of the elements.

/** Base class that also exists without a document, so that server-side rendering can import the module. */
export const Base: typeof HTMLElement = globalThis.HTMLElement ?? class {};
