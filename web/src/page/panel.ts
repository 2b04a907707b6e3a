// The panel: a bar for visitors, and behind its switch the laboratory: what arrived, and what can be changed.

import type { Choice } from "../transport/losses.ts";

export type Show = "received" | "lossless" | "difference";

export interface Settings extends Choice {
  readonly show: Show;
}

/** How what is said is meant; what is `done` is for those who look closely. */
export type Tone = "plain" | "bad" | "done";

type Slider = "dropped" | "burst" | "sent";
type Child = Node | string;

function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  fields: Record<string, string> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

const PLAY_MS = 10_000;
const HELP =
  "Drag turns, right button or two fingers move, wheel or pinch zooms; arrows, + and - do, too. " +
  "Home goes back to where it began, F turns the scene upside down, H hides this.";

export class Panel {
  readonly element = make("div", { class: "panel" });
  settings: Settings = { concealer: "grow", dropped: 0, burst: 1, seed: 0, sent: 1, show: "received" };
  readonly #state = make("p", { class: "state", role: "status" });
  readonly #show = this.#shows();
  readonly #line = make("progress", { max: "1", value: "0", "aria-label": "what has arrived" });
  readonly #bar = make("div", { class: "bar" });
  readonly #laboratory = make("section", { class: "laboratory", id: "laboratory", "aria-label": "laboratory" });
  readonly #switch = make("button", { type: "button", "aria-controls": "laboratory" }, "laboratory");
  readonly #values = new Map<string, HTMLElement>();
  readonly #facts = make("dl");
  readonly #choice = make("select", { "aria-label": "concealer" });
  readonly #sliders = new Map<Slider, { slider: HTMLInputElement; told: HTMLElement }>();
  #playing = 0;
  #chosen: string | null = null;

  /**
   * `changed` is called with every change of the settings; `copies` gives texts for the clipboard by the words on their
   * button. `fullScreen` fills the screen or ends that; null where the browser cannot.
   */
  constructor(
    readonly changed: () => void,
    readonly flip: () => void,
    readonly copies: Record<string, () => string>,
    title: string,
    fullScreen: (() => void) | null,
  ) {
    this.#list(["grow"]);
    this.#choice.addEventListener("change", () => this.set({ concealer: this.#choice.value }));
    const again = make("button", { type: "button", title: "loses other packets" }, "others");
    again.addEventListener("click", () => this.set({ seed: this.settings.seed + 1 }));
    const turn = make("button", { type: "button" }, "upside down");
    turn.addEventListener("click", flip);
    const play = make(
      "button",
      { type: "button", title: "shows the packets in the order in which they are sent" },
      "play",
    );
    play.addEventListener("click", () => this.#play());
    const losses = [
      this.#slider("dropped", "Drop packets on purpose: ", 0, 0.95, 0.01),
      this.#slider("burst", "In bursts of ", 1, 50, 1),
      again,
      this.#slider("sent", "Sent: ", 0, 1, 0.01),
      play,
      this.#show,
    ];
    this.#laboratory.append(
      this.#facts,
      make("label", {}, "Concealer ", this.#choice),
      ...losses,
      turn,
      ...Object.entries(copies).map(([words, text]) => this.#copier(words, text)),
      make("p", { class: "help" }, HELP),
    );
    this.#switch.addEventListener("click", () => (this.open = !this.open));
    const screen = make("button", { type: "button" }, "full screen");
    screen.addEventListener("click", () => fullScreen?.());
    this.#bar.append(make("p", { class: "title" }, title), this.#state, ...(fullScreen ? [screen] : []), this.#switch);
    this.element.append(this.#laboratory, make("div", { class: "foot" }, this.#line, this.#bar));
    this.open = false;
    this.set({});
  }

  /**
   * Lists the concealers that there are for a stream, and says which it lacks. Where nobody chose, or chose none of
   * these, it is `sketch`, on which the sender spent bytes, or `grow`.
   */
  offer(names: readonly string[], chosen = this.#chosen): void {
    this.#list(names);
    if (names.includes("grow") && !names.includes("sketch"))
      this.#choice.append(make("option", { value: "sketch", disabled: "" }, "sketch (the stream has none)"));
    this.set({ concealer: [chosen, "sketch", "grow"].find((name) => name && names.includes(name)) ?? names[0] });
    this.#chosen = chosen;
  }

  /** Whether the laboratory is open. */
  get open(): boolean {
    return !this.#laboratory.hidden;
  }

  set open(open: boolean) {
    this.#laboratory.hidden = !open;
    this.#switch.setAttribute("aria-expanded", String(open));
  }

  /** What can be chosen. */
  get concealers(): string[] {
    return Array.from(this.#choice.options).flatMap(({ value, disabled }) => (disabled ? [] : [value]));
  }

  #list(names: readonly string[]): void {
    this.#choice.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
  }

  set(some: Partial<Settings>): void {
    this.settings = { ...this.settings, ...some };
    this.#chosen = some.concealer ?? this.#chosen;
    this.#choice.value = this.settings.concealer;
    for (const [name, { slider, told }] of this.#sliders) {
      const value = this.settings[name];
      slider.value = String(value);
      told.textContent = name === "burst" ? `${value} packet${value === 1 ? "" : "s"}` : `${Math.round(100 * value)} %`;
    }
    for (const input of this.element.querySelectorAll<HTMLInputElement>("input[type=radio]"))
      input.checked = input.value === this.settings.show;
    this.changed();
  }

  /** Puts a player into the bar; frames that pass are not compared with those that nothing was dropped of. */
  add(player: HTMLElement): void {
    this.#bar.prepend(player);
    this.#show.remove();
  }

  destroy(): void {
    clearInterval(this.#playing);
  }

  say(text: string, tone: Tone = "plain"): void {
    this.#state.textContent = text;
    this.#state.className = `state ${tone}`;
  }

  progress(share: number): void {
    this.#line.value = share;
    this.#line.classList.toggle("full", share >= 1);
  }

  tell(row: string, text: string): void {
    (this.#values.get(row) ?? this.#row(row)).textContent = text;
  }

  #row(row: string): HTMLElement {
    const value = make("dd", {}, "-");
    this.#facts.append(make("dt", {}, row), value);
    this.#values.set(row, value);
    return value;
  }

  #slider(name: Slider, words: string, min: number, max: number, step: number): HTMLElement {
    const slider = make("input", {
        type: "range",
        "aria-label": words.trim(),
        min: String(min),
        max: String(max),
        step: String(step),
      }),
      told = make("output");
    slider.addEventListener("input", () => this.set({ [name]: Number(slider.value) }));
    this.#sliders.set(name, { slider, told });
    return make("label", {}, words, told, " ", slider);
  }

  /** Lets the packets come again. */
  #play(): void {
    const began = performance.now();
    clearInterval(this.#playing);
    this.#playing = window.setInterval(() => {
      const sent = Math.min((performance.now() - began) / PLAY_MS, 1);
      if (sent === 1) clearInterval(this.#playing);
      this.set({ sent });
    }, 250);
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
      navigator.clipboard.writeText(text()).then(
        () => told("copied"),
        () => window.prompt(words, text()),
      );
      setTimeout(() => told(words), 1500);
    });
    return button;
  }
}
