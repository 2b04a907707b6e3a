// Mouse, touch and keys, and how they move a camera.

import type { Orbit, Place } from "./orbit.ts";

const TURN = 0.005,
  KEY_TURN = 0.08,
  KEY_ZOOM = 0.9,
  /** Of the window's height. */
  KEY_PAN = 0.05,
  WHEEL = 0.0012,
  MOST_WHEEL = 200;
export class Hands {
  /** True where the wheel alone and one finger scroll the page: the scene takes Ctrl and wheel, and two fingers. */
  cooperative = false;
  readonly #pointers = new Map<number, Place>();

  /** `hint` gets a text about a gesture that was left to the page. */
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
    surface.addEventListener("dblclick", (event) => orbit.focus(placeOf(event)));
    surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    surface.addEventListener("touchmove", (event) => this.#touch(event), { passive: false });
  }

  /** Takes a key; whether it means something. */
  key(key: string, shift: boolean): boolean {
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [1, 0],
      ArrowRight: [-1, 0],
      ArrowUp: [0, 1],
      ArrowDown: [0, -1],
    };
    const turn = turns[key];
    if (turn && shift) this.orbit.pan(KEY_PAN * turn[0], KEY_PAN * turn[1]);
    else if (turn) this.orbit.turn(-turn[0] * KEY_TURN, turn[1] * KEY_TURN);
    else if (key === "+" || key === "=") this.orbit.zoom(KEY_ZOOM);
    else if (key === "-") this.orbit.zoom(1 / KEY_ZOOM);
    else if (key === "Home") this.orbit.home();
    else return false;
    return true;
  }

  #wheel(event: WheelEvent): void {
    if (this.cooperative && !event.ctrlKey && !event.metaKey) {
      const key = /Mac|iPhone|iPad/.test(navigator.platform) ? "\u2318" : "Ctrl";
      return this.hint(`${key} and the wheel zoom the scene`);
    }
    event.preventDefault();
    const turn = Math.min(Math.max(event.deltaY, -MOST_WHEEL), MOST_WHEEL);
    this.orbit.zoom(Math.exp(turn * WHEEL), placeOf(event));
  }

  /** Keeps two fingers from scrolling a page that one finger scrolls. */
  #touch(event: TouchEvent): void {
    if (!this.cooperative) return;
    if (event.touches.length > 1) event.preventDefault();
    else this.hint("Two fingers turn the scene");
  }

  #down(event: PointerEvent): void {
    if (!this.#isFirstFinger(event)) this.surface.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, placeOf(event));
  }

  /** True for a finger that may scroll the page. */
  #isFirstFinger({ pointerId, pointerType }: PointerEvent): boolean {
    const others = [...this.#pointers.keys()].some((id) => id !== pointerId);
    return this.cooperative && pointerType === "touch" && !others;
  }

  #move(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId);
    if (!before || this.#isFirstFinger(event)) return;
    const height = Math.max(this.surface.clientHeight, 1),
      now = placeOf(event),
      [dx, dy] = [now.x - before.x, now.y - before.y],
      other = [...this.#pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const far = ({ x, y }: Place): number => Math.max(Math.hypot(x - other.x, y - other.y), 1);
      this.orbit.zoom(far(before) / far(now), { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
      if (this.cooperative) this.orbit.turn((-dx * TURN) / 2, (-dy * TURN) / 2);
      else this.orbit.pan(dx / 2 / height, dy / 2 / height);
    } else if (event.buttons & 2 || event.shiftKey) this.orbit.pan(dx / height, dy / height);
    else this.orbit.turn(-dx * TURN, -dy * TURN);
    this.#pointers.set(event.pointerId, now);
  }
}

/**
 * Place of an event on the surface, in its own CSS pixels: the browser undoes transforms of the elements around it.
 * Everything within the surface that takes events lies over all of it.
 */
const placeOf = ({ offsetX, offsetY }: MouseEvent): Place => ({ x: offsetX, y: offsetY });
