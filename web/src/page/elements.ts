// Creation of DOM elements and icons.

type Child = Node | string;

export function createElement<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  fields: Record<string, string> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Outlines of the icons on a grid of 24 by 24. */
const ICONS = {
  play: "M8 5.5v13l10.5-6.5z",
  pause: "M8.5 5.5v13M15.5 5.5v13",
  reset: "M4.5 12a7.5 7.5 0 1 0 2.3-5.4L4.5 8.8M4.5 4.5v4.3h4.3",
  rotate: "M6.5 15.2C4.4 14.5 3 13.3 3 12c0-2.2 4-4 9-4s9 1.8 9 4-4 4-9 4M14.5 13.2 11.5 16l3 2.8",
  help: "M9.3 9.2a2.8 2.8 0 1 1 4 2.5c-.9.5-1.3 1-1.3 2M12 17.2v.1M12 3.5a8.5 8.5 0 1 0 0 17 8.5 8.5 0 0 0 0-17",
  headset: "M3.5 8h17v9H15l-3-3-3 3H3.5z",
  settings:
    "M4 7.5h8M18 7.5h2M4 16.5h2M12 16.5h8M15 5.5a2 2 0 1 0 0 4 2 2 0 0 0 0-4M9 14.5a2 2 0 1 0 0 4 2 2 0 0 0 0-4",
  expand: "M4.5 9.5v-5h5M14.5 4.5h5v5M19.5 14.5v5h-5M9.5 19.5h-5v-5",
  shrink: "M9.5 4.5v5h-5M19.5 9.5h-5v-5M14.5 19.5v-5h5M4.5 14.5h5v5",
  close: "M6 6l12 12M18 6 6 18",
  warning: "M12 4 2.8 19.5h18.4zM12 10v4.5M12 17v.1",
} as const;

export type IconName = keyof typeof ICONS;

const SVG = "http://www.w3.org/2000/svg";

export function icon(name: IconName): SVGSVGElement {
  const image = document.createElementNS(SVG, "svg"),
    path = document.createElementNS(SVG, "path");
  image.setAttribute("viewBox", "0 0 24 24");
  image.setAttribute("aria-hidden", "true");
  path.setAttribute("d", ICONS[name]);
  image.append(path);
  return image;
}

/** Returns a button that shows an icon. Its name is the tooltip and the text for screen readers. */
export function iconButton(name: string, image: IconName, fields: Record<string, string> = {}): HTMLButtonElement {
  const button = createElement("button", { type: "button", part: "button", ...fields });
  setIcon(button, name, image);
  return button;
}

/** Changes name and icon of a button. */
export function setIcon(button: HTMLButtonElement, name: string, image: IconName): void {
  button.title = name;
  button.replaceChildren(icon(image), createElement("span", { class: "name" }, name));
}
