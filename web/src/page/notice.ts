// Notice over the scene while there is no picture: loading, offline, or an error with a button that tries again.

import { createElement, icon } from "./elements.ts";

export type NoticeKind = "loading" | "offline" | "error";

export class Notice {
  readonly element = createElement("div", { class: "notice", part: "notice" });
  readonly #text = createElement("p");
  readonly #retry = createElement("button", { type: "button", part: "button" }, "try again");

  /** `retry` starts the stream again. */
  constructor(retry: () => void) {
    this.#retry.addEventListener("click", retry);
    this.hide();
  }

  show(kind: NoticeKind, text: string): void {
    const image = kind === "loading" ? createElement("span", { class: "spinner" }) : icon("warning");
    this.#text.textContent = text;
    this.element.className = `notice ${kind}`;
    this.element.replaceChildren(image, this.#text, ...(kind === "loading" ? [] : [this.#retry]));
    this.element.hidden = false;
  }

  hide(): void {
    this.element.hidden = true;
  }
}
