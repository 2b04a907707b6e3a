// The style sheet of the element, in each document that it is in.

import { STYLE } from "./style.ts";

const sheets = new WeakMap<Document, CSSStyleSheet>();

/** Gives a shadow root its styles. A document takes constructed sheets of its own window only. */
export function dress(root: ShadowRoot): void {
  const { ownerDocument } = root,
    Sheet = (ownerDocument.defaultView as (Window & typeof globalThis) | null)?.CSSStyleSheet;
  if (!Sheet) return; // a document without a window is not shown
  let sheet = sheets.get(ownerDocument);
  if (!sheet) {
    sheet = new Sheet();
    sheet.replaceSync(STYLE);
    sheets.set(ownerDocument, sheet);
  }
  root.adoptedStyleSheets = [sheet];
}
