// View updates: requests the Gaussians of a view after a large movement of the camera, or at rest. One request at a
// time.

import { type Camera, cameraPosition } from "../model/camera.ts";

const REST_MS = 150;
/** Movement that triggers an update: relative to the scene's size, and change of the camera's axes. */
const MOVED = 0.01,
  MIN_ROTATION = 0.03;

export class ViewUpdates {
  #requested: Camera | null = null;
  #pending: Camera | null = null;
  #requestCount = 0;
  #answerCount = 0;
  #timer = 0;

  /** `request` requests the Gaussians for a camera; `size` is that of the scene. */
  constructor(
    readonly size: number,
    readonly request: (camera: Camera, requestId: number) => void,
  ) {}

  /** True if the last answer is for the camera of the last frame. */
  get settled(): boolean {
    return !this.#pending && this.#requestCount === this.#answerCount;
  }

  /** Reports the camera of a frame. */
  onCamera(camera: Camera): void {
    this.#pending = this.#requested && cameraDistance(camera, this.#requested, this.size) === 0 ? null : camera;
    this.#update();
  }

  /** Requests the Gaussians for the last camera again. */
  repeat(): void {
    this.#pending ??= this.#requested;
    this.#requested = null;
    this.#update();
  }

  onAnswer(requestId: number): void {
    this.#answerCount = requestId;
    this.#update();
  }

  #update(): void {
    if (!this.#pending || this.#requestCount !== this.#answerCount) return;
    if (!this.#requested || cameraDistance(this.#pending, this.#requested, this.size) >= 1) return this.#send();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(
      () => this.#requestCount === this.#answerCount && this.#send(),
      REST_MS,
    ) as unknown as number;
  }

  #send(): void {
    clearTimeout(this.#timer);
    if (!this.#pending) return;
    this.#requested = this.#pending;
    this.#pending = null;
    this.request(this.#requested, ++this.#requestCount);
  }
}

/** Returns the distance of two cameras in units of the update threshold; 0 for equal ones. */
export function cameraDistance(a: Camera, b: Camera, size: number): number {
  if (a.focal !== b.focal || a.width !== b.width || a.height !== b.height || a.margin !== b.margin) return 1;
  const eye = cameraPosition(a),
    other = cameraPosition(b),
    moved = Math.hypot(...eye.map((value, n) => value - other[n])) / (MOVED * size);
  const turned =
    Math.max(...[0, 1, 2].map((row) => Math.hypot(...[0, 1, 2].map((n) => a.viewmat[row][n] - b.viewmat[row][n])))) /
    MIN_ROTATION;
  return Math.max(moved, turned);
}
