// Hotspots: children of the element with slot="hotspot" and data-position="x y z" (world units) follow their point of
// the scene.

import type { Camera } from "../model/camera.ts";
import { createElement } from "./elements.ts";

/** Smallest depth at which a hotspot is visible, relative to the size of the scene. */
const MIN_DEPTH = 1e-3;

/** Returns true for an element of any document: classes differ between windows. */
const hasStyle = (element: Element): element is HTMLElement => "style" in element;

export class Hotspots {
  readonly slot = createElement("slot", { name: "hotspot" });
  #positions: (readonly [HTMLElement, readonly number[]])[] = [];

  /** `changed` is called after hotspots were added or removed. */
  constructor(changed: () => void) {
    this.slot.addEventListener("slotchange", () => {
      this.#positions = this.slot.assignedElements().flatMap((element) => {
        const position = (element.getAttribute("data-position") ?? "").trim().split(/\s+/).map(Number);
        if (!hasStyle(element)) return [];
        element.style.visibility = "hidden";
        return position.length === 3 && position.every(Number.isFinite) ? [[element, position] as const] : [];
      });
      changed();
    });
  }

  get isEmpty(): boolean {
    return !this.#positions.length;
  }

  /** Moves every hotspot to its point in the picture. Hides those behind the camera or outside of the picture. */
  place({ viewmat, focal, width, height }: Camera, size: number): void {
    for (const [element, [x, y, z]] of this.#positions) {
      const [across, down, depth] = viewmat.slice(0, 3).map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]),
        left = width / 2 + (focal * across) / depth,
        top = height / 2 + (focal * down) / depth,
        inside = depth > MIN_DEPTH * size && left >= 0 && left <= width && top >= 0 && top <= height;
      element.style.visibility = inside ? "visible" : "hidden";
      if (inside)
        element.style.transform = `translate(${left.toFixed(1)}px, ${top.toFixed(1)}px) translate(-50%, -50%)`;
    }
  }
}
