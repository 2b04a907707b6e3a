// The panel: what arrived, and what can be changed.

import { CONCEALERS } from "../conceal/conceal.ts";

export type Show = "received" | "lossless" | "difference";

export interface Settings {
  concealer: string;
  /** Share of the packets that is dropped on purpose. */
  dropped: number;
  seed: number;
  show: Show;
}

type Child = Node | string;

function make<K extends keyof HTMLElementTagNameMap>(tag: K, fields: Record<string, string> = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const ROWS = ["packets", "Gaussians", "received", "rate", "lost on the way", "dropped on purpose", "time", "decoding", "way"] as const;
export type Row = (typeof ROWS)[number] | "PSNR";
const HELP = "Drag turns, right button or two fingers move, wheel or pinch zooms; arrows, + and - do, too. F turns the scene upside down, H hides this.";

export class Panel {
  readonly element = make("details", { class: "panel", open: "" });
  readonly settings: Settings = { concealer: "grow", dropped: 0, seed: 0, show: "received" };
  readonly #state = make("p", { class: "state", role: "status" });
  readonly #bar = make("progress", { max: "1", value: "0", "aria-label": "what has arrived" });
  readonly #values = new Map<Row, HTMLElement>();
  readonly #facts = make("dl");
  readonly #share = make("output");
  readonly #slider = make("input", { type: "range", min: "0", max: "0.95", step: "0.01", value: "0", "aria-label": "packets dropped on purpose" });
  readonly #choice = make("select", { "aria-label": "concealer" }, ...Object.keys(CONCEALERS).map((name) => make("option", { value: name }, name)));

  /** `changed` is called with every change of the settings; `copies` gives texts for the clipboard by the words on their button. */
  constructor(readonly changed: () => void, readonly flip: () => void, readonly copies: Record<string, () => string>) {
    for (const row of ROWS) this.#row(row);
    this.#choice.value = this.settings.concealer;
    this.#choice.addEventListener("change", () => this.set({ concealer: this.#choice.value }));
    this.#slider.addEventListener("input", () => this.set({ dropped: Number(this.#slider.value) }));
    const again = make("button", { type: "button", title: "loses other packets" }, "others");
    again.addEventListener("click", () => this.set({ seed: this.settings.seed + 1 }));
    const turn = make("button", { type: "button" }, "upside down");
    turn.addEventListener("click", flip);
    this.element.append(
      make("summary", {}, "splatwire"), this.#state, this.#bar, this.#facts,
      make("label", {}, "Concealer ", this.#choice),
      make("label", {}, "Drop packets on purpose: ", this.#share, " ", this.#slider), again, turn, this.#shows(),
      ...Object.entries(copies).map(([words, text]) => this.#copier(words, text)),
      make("p", { class: "help" }, HELP),
    );
    this.set({});
  }

  set(some: Partial<Settings>): void {
    Object.assign(this.settings, some);
    this.#choice.value = this.settings.concealer;
    this.#slider.value = String(this.settings.dropped);
    this.#share.textContent = `${Math.round(100 * this.settings.dropped)} %`;
    for (const input of this.element.querySelectorAll<HTMLInputElement>("input[type=radio]")) input.checked = input.value === this.settings.show;
    this.changed();
  }

  say(text: string, bad = false): void {
    this.#state.textContent = text;
    this.#state.classList.toggle("bad", bad);
  }

  progress(share: number): void {
    this.#bar.value = share;
  }

  tell(row: Row, text: string): void {
    (this.#values.get(row) ?? this.#row(row)).textContent = text;
  }

  #row(row: Row): HTMLElement {
    const value = make("dd", {}, "-");
    this.#facts.append(make("dt", {}, row), value);
    this.#values.set(row, value);
    return value;
  }

  #shows(): HTMLElement {
    const group = make("fieldset", { "aria-label": "what is shown" });
    for (const show of ["received", "lossless", "difference"] as const) {
      const input = make("input", { type: "radio", name: "show", value: show });
      input.addEventListener("change", () => this.set({ show }));
      group.append(make("label", {}, input, show));
    }
    return group;
  }

  #copier(words: string, text: () => string): HTMLElement {
    const button = make("button", { type: "button" }, words);
    button.addEventListener("click", () => {
      const told = (said: string): void => void (button.textContent = said);
      if (!navigator.clipboard) return void window.prompt(words, text());
      navigator.clipboard.writeText(text()).then(() => told("copied"), () => window.prompt(words, text()));
      setTimeout(() => told(words), 1500);
    });
    return button;
  }
}
