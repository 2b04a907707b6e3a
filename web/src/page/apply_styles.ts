// Applies the element's style sheet in each document.

import { STYLE } from "./style.ts";

const sheets = new WeakMap<Document, CSSStyleSheet>();

/** Applies the styles to a shadow root. A document accepts only sheets constructed in its own window. */
export function applyStyles(root: ShadowRoot): void {
  const { ownerDocument } = root,
    Sheet = (ownerDocument.defaultView as (Window & typeof globalThis) | null)?.CSSStyleSheet;
  if (!Sheet) return; // a document without a window is not displayed
  let sheet = sheets.get(ownerDocument);
  if (!sheet) {
    sheet = new Sheet();
    sheet.replaceSync(STYLE);
    sheets.set(ownerDocument, sheet);
  }
  root.adoptedStyleSheets = [sheet];
}
