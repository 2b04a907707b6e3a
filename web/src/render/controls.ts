// Camera controls: mouse, touch and keyboard.

import { cssZoomOf } from "./css_zoom.ts";
import type { Orbit, WindowPosition } from "./orbit.ts";

const ROTATION_PER_PIXEL = 0.005,
  KEY_ROTATION = 0.08,
  KEY_ZOOM = 0.9,
  /** Fraction of the window's height. */
  KEY_PAN = 0.05,
  ZOOM_PER_WHEEL_PIXEL = 0.0012,
  MAX_WHEEL_DELTA = 200;
export class Controls {
  /** If true, the plain wheel and one finger scroll the page. The scene takes Ctrl + wheel and two fingers. */
  cooperative = false;
  readonly #pointers = new Map<number, WindowPosition>();

  /** `hint` is called with a text if a gesture was left to the page. */
  constructor(
    readonly surface: HTMLElement,
    readonly orbit: Orbit,
    readonly hint: (text: string) => void = () => undefined,
  ) {
    surface.addEventListener("pointerdown", (event) => this.#down(event));
    surface.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      surface.addEventListener(kind, (event) => this.#pointers.delete(event.pointerId));
    }
    surface.addEventListener("contextmenu", (event) => event.preventDefault());
    surface.addEventListener("dblclick", (event) => orbit.focus(eventPosition(event)));
    surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    surface.addEventListener("touchmove", (event) => this.#touch(event), { passive: false });
  }

  /** Handles a key. Returns true if it is assigned. */
  key(key: string, shift: boolean): boolean {
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [1, 0],
      ArrowRight: [-1, 0],
      ArrowUp: [0, 1],
      ArrowDown: [0, -1],
    };
    const turn = turns[key];
    if (turn && shift) this.orbit.pan(KEY_PAN * turn[0], KEY_PAN * turn[1]);
    else if (turn) this.orbit.rotate(-turn[0] * KEY_ROTATION, turn[1] * KEY_ROTATION);
    else if (key === "+" || key === "=") this.orbit.zoom(KEY_ZOOM);
    else if (key === "-") this.orbit.zoom(1 / KEY_ZOOM);
    else if (key === "Home") this.orbit.reset();
    else return false;
    return true;
  }

  #wheel(event: WheelEvent): void {
    if (this.cooperative && !event.ctrlKey && !event.metaKey) {
      const key = /Mac|iPhone|iPad/.test(navigator.platform) ? "\u2318" : "Ctrl";
      return this.hint(`${key} + wheel zooms the scene`);
    }
    event.preventDefault();
    const turn = Math.min(Math.max(event.deltaY, -MAX_WHEEL_DELTA), MAX_WHEEL_DELTA);
    this.orbit.zoom(Math.exp(turn * ZOOM_PER_WHEEL_PIXEL), eventPosition(event));
  }

  /** Prevents two fingers from scrolling the page in cooperative mode. */
  #touch(event: TouchEvent): void {
    if (!this.cooperative) return;
    if (event.touches.length > 1) event.preventDefault();
    else this.hint("Use two fingers to rotate the scene");
  }

  #down(event: PointerEvent): void {
    if (!this.#isFirstFinger(event)) this.surface.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, eventPosition(event));
  }

  /** Returns true for a finger that may scroll the page. */
  #isFirstFinger({ pointerId, pointerType }: PointerEvent): boolean {
    const others = [...this.#pointers.keys()].some((id) => id !== pointerId);
    return this.cooperative && pointerType === "touch" && !others;
  }

  #move(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId);
    if (!before || this.#isFirstFinger(event)) return;
    const height = Math.max(this.surface.clientHeight, 1),
      now = eventPosition(event),
      [dx, dy] = [now.x - before.x, now.y - before.y],
      other = [...this.#pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const far = ({ x, y }: WindowPosition): number => Math.max(Math.hypot(x - other.x, y - other.y), 1);
      this.orbit.zoom(far(before) / far(now), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
      if (this.cooperative) this.orbit.rotate((-dx * ROTATION_PER_PIXEL) / 2, (-dy * ROTATION_PER_PIXEL) / 2);
      else this.orbit.pan(dx / 2 / height, dy / 2 / height);
    } else if (event.buttons & 2 || event.shiftKey) this.orbit.pan(dx / height, dy / height);
    else this.orbit.rotate(-dx * ROTATION_PER_PIXEL, -dy * ROTATION_PER_PIXEL);
    this.#pointers.set(event.pointerId, now);
  }
}

/**
 * Returns an event's position on the surface in its CSS pixels, corrected for transforms and CSS zoom of ancestors. All
 * children that receive events cover the whole surface.
 */
function eventPosition({ offsetX, offsetY, target }: MouseEvent): WindowPosition {
  const zoom = cssZoomOf(target as Element); // offsets contain the zoom, but client sizes do not
  return { x: offsetX / zoom, y: offsetY / zoom };
}
