// Smooth movement of the camera to a viewpoint.

import type { AnimationFrame } from "../render/animation_frame.ts";
import type { Orbit, OrbitState } from "../render/orbit.ts";

export class Flight {
  #done: ((arrived: boolean) => void) | null = null;

  constructor(
    readonly orbit: Orbit,
    readonly frame: AnimationFrame,
  ) {}

  /** Moves to a state of the orbit. Resolves to true on arrival, to false if it was stopped. */
  start(to: OrbitState, seconds: number): Promise<boolean> {
    this.stop();
    const from = this.orbit.state,
      began = performance.now(),
      still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    return new Promise((resolve) => {
      this.#done = resolve;
      const step = (): void => {
        const time = still || !(seconds > 0) ? 1 : Math.min((performance.now() - began) / (1000 * seconds), 1);
        this.orbit.moveBetween(from, to, time * time * (3 - 2 * time));
        if (time < 1) this.frame.request(step);
        else this.#end(true);
      };
      step();
    });
  }

  /** Stops the movement, because the visitor moves the camera or the element is released. */
  stop(): void {
    this.#end(false);
  }

  #end(arrived: boolean): void {
    this.frame.cancel();
    this.#done?.(arrived);
    this.#done = null;
  }
}
