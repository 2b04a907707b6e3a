// The CSS property `zoom` of an element and its ancestors.

/** Returns the product of all zooms of an element; 1 in browsers that do not report it. */
export const cssZoomOf = (element: Element): number =>
  (element as Element & { readonly currentCSSZoom?: number }).currentCSSZoom ?? 1;
