// Help: gestures and keys of the viewer.

import { createElement, iconButton } from "./elements.ts";

const GESTURES: readonly (readonly [string, string])[] = [
  ["drag", "rotate"],
  ["right button, two fingers", "move"],
  ["wheel, pinch", "zoom"],
  ["double click", "rotate around that point"],
];
const KEYS: readonly (readonly [string, string])[] = [
  ["arrows", "rotate; with Shift: move"],
  ["+ -", "zoom"],
  ["Home", "first view"],
  ["Space", "play, pause"],
  ["F", "upside down"],
  ["H", "hide or show the controls"],
  ["?", "this help"],
];

export class Help {
  readonly element = createElement("section", { class: "help", part: "help", role: "dialog", "aria-label": "help" });
  readonly #close = iconButton("close", "close");

  /** `closed` is called when the visitor closes the help. */
  constructor(closed: () => void) {
    this.element.append(this.#close);
    for (const [title, rows] of [
      ["Gestures", GESTURES],
      ["Keys", KEYS],
    ] as const) {
      const list = createElement("dl"),
        group = createElement("div", { class: title.toLowerCase() }, createElement("h2", {}, title), list);
      for (const [input, effect] of rows) list.append(createElement("dt", {}, input), createElement("dd", {}, effect));
      this.element.append(group);
    }
    this.#close.addEventListener("click", closed);
    this.element.addEventListener("keydown", (event) => {
      if (event.key === "Escape") closed();
      event.stopPropagation();
    });
    this.element.hidden = true;
  }

  get open(): boolean {
    return !this.element.hidden;
  }

  set open(open: boolean) {
    this.element.hidden = !open;
    if (open) this.#close.focus();
  }
}
