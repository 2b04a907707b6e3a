// Automatic rotation of the camera around the scene.

import type { AnimationFrame } from "../render/animation_frame.ts";
import type { Orbit } from "../render/orbit.ts";

/** Default speed, degrees per second. */
const DEFAULT_SPEED = 12;
/** Time after the last input of the visitor before the rotation continues, milliseconds. */
const PAUSE_MS = 3000;

export class AutoRotation {
  readonly #reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
  /** Radians per second; 0 stops. */
  #speed = 0;
  #last = 0;
  #inputAt = -Infinity;
  #isVisible = true;

  /** `changed` is called when the rotation starts or stops because the visitor's preference for motion changes. */
  constructor(
    readonly orbit: Orbit,
    readonly frame: AnimationFrame,
    changed: () => void,
  ) {
    this.#reducedMotion.onchange = () => {
      this.#run();
      changed();
    };
  }

  /**
   * Sets the speed by an attribute: degrees per second, the default for an empty text or `true`, none for null or no
   * number. Nothing rotates while the visitor prefers reduced motion.
   */
  set(value: string | null): void {
    const degrees = value === null ? 0 : /^(true)?$/.test(value.trim()) ? DEFAULT_SPEED : Number(value);
    this.#speed = Number.isFinite(degrees) ? (degrees * Math.PI) / 180 : 0;
    this.#run();
  }

  get isOn(): boolean {
    return this.#speed !== 0;
  }

  /** True if the scene rotates: switched on, and the visitor does not prefer reduced motion. */
  get running(): boolean {
    return this.isOn && !this.#reducedMotion.matches;
  }

  /** Pauses the rotation for some seconds, because the visitor uses the scene. */
  onInput(): void {
    this.#inputAt = performance.now();
  }

  setVisible(isVisible: boolean): void {
    this.#isVisible = isVisible;
    this.#run();
  }

  destroy(): void {
    this.#reducedMotion.onchange = null;
    this.frame.cancel();
  }

  #run(): void {
    this.frame.cancel();
    this.#last = 0;
    if (this.running && this.#isVisible) this.frame.request((now) => this.#step(now));
  }

  #step(now: number): void {
    const seconds = this.#last ? Math.min(Math.max(now - this.#last, 0) / 1000, 0.1) : 0; // windows differ in their 0
    this.#last = now;
    if (seconds && performance.now() - this.#inputAt > PAUSE_MS) this.orbit.drift(this.#speed * seconds);
    this.frame.request((later) => this.#step(later));
  }
}
