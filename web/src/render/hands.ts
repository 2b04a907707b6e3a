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
  readonly #pointers = new Map<number, Place>();

  constructor(
    readonly surface: HTMLElement,
    readonly orbit: Orbit,
  ) {
    surface.addEventListener("pointerdown", (event) => this.#down(event));
    surface.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      surface.addEventListener(kind, (event) => this.#pointers.delete(event.pointerId));
    }
    surface.addEventListener("contextmenu", (event) => event.preventDefault());
    surface.addEventListener("dblclick", (event) => orbit.focus(this.#placeOf(event)));
    surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
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
    event.preventDefault();
    const turn = Math.min(Math.max(event.deltaY, -MOST_WHEEL), MOST_WHEEL);
    this.orbit.zoom(Math.exp(turn * WHEEL), this.#placeOf(event));
  }

  #placeOf({ clientX, clientY }: { clientX: number; clientY: number }): Place {
    const { left, top } = this.surface.getBoundingClientRect();
    return { x: clientX - left, y: clientY - top };
  }

  #down(event: PointerEvent): void {
    this.surface.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  #move(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const height = Math.max(this.surface.clientHeight, 1),
      now = { x: event.clientX, y: event.clientY },
      [dx, dy] = [now.x - before.x, now.y - before.y],
      other = [...this.#pointers.entries()].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const far = ({ x, y }: Place): number => Math.max(Math.hypot(x - other.x, y - other.y), 1);
      this.orbit.zoom(
        far(before) / far(now),
        this.#placeOf({ clientX: (now.x + other.x) / 2, clientY: (now.y + other.y) / 2 }),
      );
      this.orbit.pan(dx / 2 / height, dy / 2 / height);
    } else if (event.buttons & 2 || event.shiftKey) this.orbit.pan(dx / height, dy / height);
    else this.orbit.turn(-dx * TURN, -dy * TURN);
    this.#pointers.set(event.pointerId, now);
  }
}
