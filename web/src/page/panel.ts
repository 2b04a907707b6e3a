// Panel: controls over the lower edge of the scene, and a "laboratory" with statistics and settings.

import type { LossSimulation } from "../transport/losses.ts";
import { createElement, iconButton, setIcon } from "./elements.ts";
import { Help } from "./help.ts";
import { Notice, type NoticeKind } from "./notice.ts";

export type PictureMode = "received" | "lossless" | "difference";

export interface Settings extends LossSimulation {
  readonly show: PictureMode;
}

/** Style of a status message. `done` is visible only while the laboratory is open. */
export type MessageStyle = "plain" | "bad" | "done";

type Slider = "lossRate" | "burstLength" | "sentShare";

/** Actions of the buttons. */
export interface PanelActions {
  /** Called after every change of the settings. */
  readonly changed: () => void;
  /** Turns the scene upside down. */
  readonly flip: () => void;
  /** Returns to the first view. */
  readonly reset: () => void;
  /** Starts or stops the automatic rotation. */
  readonly rotate: () => void;
  /** Starts the stream again. */
  readonly retry: () => void;
  /** Toggles full screen; null if the browser does not support it. */
  readonly fullScreen: (() => void) | null;
  /** Texts for the clipboard by the label of their button. */
  readonly copies: Record<string, () => string>;
}

const REPLAY_MS = 10_000;

export class Panel {
  readonly element = createElement("div", { class: "panel" });
  settings: Settings = { concealer: "grow", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1, show: "received" };
  readonly #state = createElement("p", { class: "state", part: "status", role: "status" });
  readonly #show = this.#pictureModes();
  readonly #title = createElement("p", { class: "title", part: "title" });
  readonly #progressBar = createElement("progress", {
    part: "progress",
    max: "1",
    value: "0",
    "aria-label": "received",
  });
  readonly #bar = createElement("div", { class: "bar", part: "controls" });
  readonly #laboratory = createElement("section", {
    class: "laboratory",
    part: "laboratory",
    id: "laboratory",
    "aria-label": "laboratory",
  });
  readonly #switch = iconButton("laboratory", "settings", { "aria-controls": "laboratory" });
  readonly #rotation = iconButton("rotate automatically", "rotate", { "aria-pressed": "false" });
  readonly #screen = iconButton("full screen", "expand");
  readonly #help = new Help(() => this.showHelp(false));
  readonly #helpSwitch = iconButton("help", "help", { "aria-expanded": "false" });
  readonly #notice: Notice;
  readonly #values = new Map<string, HTMLElement>();
  readonly #facts = createElement("dl");
  readonly #concealerSelect = createElement("select", { "aria-label": "concealer" });
  readonly #sliders = new Map<Slider, { slider: HTMLInputElement; output: HTMLElement }>();
  #replayTimer = 0;
  #chosen: string | null = null;

  constructor(
    readonly actions: PanelActions,
    title: string,
  ) {
    const { flip, reset, rotate, retry, fullScreen, copies } = actions;
    this.title = title;
    this.#list(["grow"]);
    this.#concealerSelect.addEventListener("change", () => this.set({ concealer: this.#concealerSelect.value }));
    const again = createElement("button", { type: "button", title: "drop other packets" }, "other packets");
    again.addEventListener("click", () => this.set({ seed: this.settings.seed + 1 }));
    const turn = createElement("button", { type: "button" }, "upside down");
    turn.addEventListener("click", flip);
    const play = createElement("button", { type: "button", title: "replay the packets in sending order" }, "play");
    play.addEventListener("click", () => this.#replay());
    const losses = [
      this.#slider("lossRate", "Drop packets on purpose: ", 0, 0.95, 0.01),
      this.#slider("burstLength", "In bursts of ", 1, 50, 1),
      again,
      this.#slider("sentShare", "Sent: ", 0, 1, 0.01),
      play,
      this.#show,
    ];
    this.#laboratory.append(
      this.#facts,
      createElement("label", {}, "Concealer ", this.#concealerSelect),
      ...losses,
      turn,
      ...Object.entries(copies).map(([words, text]) => this.#copyButton(words, text)),
    );
    this.#switch.addEventListener("click", () => (this.open = !this.open));
    this.#helpSwitch.addEventListener("click", () => this.showHelp(!this.#help.open));
    this.#rotation.addEventListener("click", rotate);
    this.#screen.addEventListener("click", () => fullScreen?.());
    const first = iconButton("first view", "reset");
    first.addEventListener("click", reset);
    this.#bar.append(
      createElement("div", { class: "texts" }, this.#title, this.#state),
      first,
      this.#rotation,
      this.#helpSwitch,
      this.#switch,
      ...(fullScreen ? [this.#screen] : []),
    );
    this.#notice = new Notice(retry);
    this.element.append(
      this.#laboratory,
      this.#notice.element,
      createElement("div", { class: "foot" }, this.#progressBar, this.#bar),
      this.#help.element,
    );
    this.open = false;
    this.set({});
  }

  /** Shows a notice over the scene, which has no picture yet. */
  showNotice(kind: NoticeKind, text: string): void {
    this.#notice.show(kind, text);
  }

  hideNotice(): void {
    this.#notice.hide();
  }

  /** Opens or closes the help. Returns the focus to its button. */
  showHelp(open: boolean): void {
    const had = this.#help.open;
    this.#help.open = open;
    this.#helpSwitch.setAttribute("aria-expanded", String(open));
    if (had && !open) this.#helpSwitch.focus();
  }

  get helpOpen(): boolean {
    return this.#help.open;
  }

  /** Calls `used` whenever a pointer or the focus reaches the controls. */
  onUse(used: () => void): void {
    for (const name of ["pointerenter", "focusin"]) this.#bar.addEventListener(name, used);
  }

  /** Adds a button that shows the scene in a headset. It is the first one, so that no other button moves. */
  addHeadset(enter: () => void): void {
    const button = iconButton("show in a headset", "headset");
    button.addEventListener("click", enter);
    this.#title.parentElement!.after(button);
  }

  /** Shows whether the camera rotates automatically. */
  set rotating(rotating: boolean) {
    this.#rotation.setAttribute("aria-pressed", String(rotating));
  }

  /** Shows whether the element fills the screen. */
  set fullScreen(isFull: boolean) {
    setIcon(this.#screen, isFull ? "exit full screen" : "full screen", isFull ? "shrink" : "expand");
  }

  /** Lists the stream's concealers. The default is `sketch` if the stream has redundant copies, else `grow`. */
  setConcealers(names: readonly string[], chosen = this.#chosen): void {
    this.#list(names);
    if (names.includes("grow") && !names.includes("sketch"))
      this.#concealerSelect.append(
        createElement("option", { value: "sketch", disabled: "" }, "sketch (not in this stream)"),
      );
    this.set({ concealer: [chosen, "sketch", "grow"].find((name) => name && names.includes(name)) ?? names[0] });
    this.#chosen = chosen;
  }

  /** True if the laboratory is open. */
  get open(): boolean {
    return !this.#laboratory.hidden;
  }

  set open(open: boolean) {
    this.#laboratory.hidden = !open;
    this.#switch.setAttribute("aria-expanded", String(open));
  }

  /** Selectable concealers. */
  get concealers(): string[] {
    return Array.from(this.#concealerSelect.options).flatMap(({ value, disabled }) => (disabled ? [] : [value]));
  }

  #list(names: readonly string[]): void {
    this.#concealerSelect.replaceChildren(...names.map((name) => createElement("option", { value: name }, name)));
  }

  set(some: Partial<Settings>): void {
    this.settings = { ...this.settings, ...some };
    this.#chosen = some.concealer ?? this.#chosen;
    this.#concealerSelect.value = this.settings.concealer;
    for (const [name, { slider, output }] of this.#sliders) {
      const value = this.settings[name];
      slider.value = String(value);
      output.textContent =
        name === "burstLength" ? `${value} packet${value === 1 ? "" : "s"}` : `${Math.round(100 * value)} %`;
    }
    for (const input of this.element.querySelectorAll<HTMLInputElement>("input[type=radio]"))
      input.checked = input.value === this.settings.show;
    this.actions.changed();
  }

  /** Adds a player to the bar. Removes the comparison, which needs a static scene. */
  add(player: HTMLElement): void {
    this.#bar.prepend(player);
    this.#show.remove();
  }

  destroy(): void {
    clearInterval(this.#replayTimer);
  }

  setMessage(text: string, tone: MessageStyle = "plain"): void {
    this.#state.textContent = text;
    this.#state.className = `state ${tone}`;
  }

  /** Title of the scene in the bar; long ones are cut there and complete in the tooltip. */
  set title(text: string) {
    this.#title.textContent = this.#title.title = text;
  }

  progress(share: number): void {
    this.#progressBar.value = share;
    this.#progressBar.classList.toggle("full", share >= 1);
  }

  /** Sets a row of the statistics. An optional row is absent while its text is empty. */
  setRow(row: string, text: string, isOptional = false): void {
    if (isOptional && !text) return this.#removeRow(row);
    (this.#values.get(row) ?? this.#row(row)).textContent = text;
  }

  #removeRow(row: string): void {
    const value = this.#values.get(row);
    value?.previousElementSibling?.remove();
    value?.remove();
    this.#values.delete(row);
  }

  #row(row: string): HTMLElement {
    const value = createElement("dd", {}, "-");
    this.#facts.append(createElement("dt", {}, row), value);
    this.#values.set(row, value);
    return value;
  }

  #slider(name: Slider, words: string, min: number, max: number, step: number): HTMLElement {
    const slider = createElement("input", {
        type: "range",
        "aria-label": words.trim(),
        min: String(min),
        max: String(max),
        step: String(step),
      }),
      output = createElement("output");
    slider.addEventListener("input", () => this.set({ [name]: Number(slider.value) }));
    this.#sliders.set(name, { slider, output });
    return createElement("label", {}, words, output, " ", slider);
  }

  /** Replays the arrival of the packets. */
  #replay(): void {
    const began = performance.now();
    clearInterval(this.#replayTimer);
    this.#replayTimer = window.setInterval(() => {
      const sentShare = Math.min((performance.now() - began) / REPLAY_MS, 1);
      if (sentShare === 1) clearInterval(this.#replayTimer);
      this.set({ sentShare });
    }, 250);
  }

  #pictureModes(): HTMLElement {
    const group = createElement("fieldset", { "aria-label": "displayed picture" });
    for (const show of ["received", "lossless", "difference"] as const) {
      const input = createElement("input", { type: "radio", name: "show", value: show });
      input.addEventListener("change", () => this.set({ show }));
      group.append(createElement("label", {}, input, show));
    }
    // a form, because Chromium retains radio buttons without one after the panel is removed
    return createElement("form", { method: "dialog" }, group);
  }

  #copyButton(words: string, text: () => string): HTMLElement {
    const button = createElement("button", { type: "button" }, words);
    button.addEventListener("click", () => {
      const output = (said: string): void => void (button.textContent = said),
        window = button.ownerDocument.defaultView!, // only the window with the focus may write to the clipboard
        { clipboard } = window.navigator;
      if (!clipboard) return void window.prompt(words, text());
      clipboard.writeText(text()).then(
        () => output("copied"),
        () => window.prompt(words, text()),
      );
      setTimeout(() => output(words), 1500);
    });
    return button;
  }
}
