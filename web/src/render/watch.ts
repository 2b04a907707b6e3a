// When the Gaussians of a view are asked for anew: the camera moved enough, or a little and then stands still; one
// question at a time.

import { type Camera, eyeOf } from "../model/camera.ts";

const STILL_MS = 150;
/** What is enough: shares of the distance to the scene, and of the directions of the camera's axes. */
const MOVED = 0.01,
  TURNED = 0.03;

export class Watch {
  #asked: Camera | null = null;
  #wanted: Camera | null = null;
  #ask = 0;
  #answered = 0;
  #timer = 0;

  /** `look` asks for the Gaussians that a camera sees; `size` is that of the scene. */
  constructor(
    readonly size: number,
    readonly look: (camera: Camera, ask: number) => void,
  ) {}

  /** Whether what was answered last is what the camera of the last frame sees. */
  get settled(): boolean {
    return !this.#wanted && this.#ask === this.#answered;
  }

  /** The camera of a frame. */
  see(camera: Camera): void {
    this.#wanted = this.#asked && distance(camera, this.#asked, this.size) === 0 ? null : camera;
    this.#decide();
  }

  answered(ask: number): void {
    this.#answered = ask;
    this.#decide();
  }

  #decide(): void {
    if (!this.#wanted || this.#ask !== this.#answered) return;
    if (!this.#asked || distance(this.#wanted, this.#asked, this.size) >= 1) return this.#now();
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#ask === this.#answered && this.#now(), STILL_MS) as unknown as number;
  }

  #now(): void {
    clearTimeout(this.#timer);
    if (!this.#wanted) return;
    this.#asked = this.#wanted;
    this.#wanted = null;
    this.look(this.#asked, ++this.#ask);
  }
}

/** How far two cameras are apart: 0 for the same, 1 for enough to ask anew. */
export function distance(a: Camera, b: Camera, size: number): number {
  if (a.focal !== b.focal || a.width !== b.width || a.height !== b.height || a.margin !== b.margin) return 1;
  const eye = eyeOf(a),
    other = eyeOf(b),
    moved = Math.hypot(...eye.map((value, n) => value - other[n])) / (MOVED * size);
  const turned =
    Math.max(...[0, 1, 2].map((row) => Math.hypot(...[0, 1, 2].map((n) => a.viewmat[row][n] - b.viewmat[row][n])))) /
    TURNED;
  return Math.max(moved, turned);
}
