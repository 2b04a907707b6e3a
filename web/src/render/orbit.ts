// A camera that turns around a point: mouse, touch and keys.

import { Quat, Vec3 } from "playcanvas";

import type { Camera } from "../model/camera.ts";

const TURN = 0.005,
  KEY_TURN = 0.08,
  KEY_ZOOM = 0.9,
  WHEEL = 0.0012,
  STEEPEST = 1.55;
const UPSIDE_DOWN = new Quat().setFromEulerAngles(0, 0, 180);

/** Vertical field of view, degrees. */
export const FIELD_OF_VIEW = 50;

export interface Pose {
  readonly position: Vec3;
  readonly rotation: Quat;
}

/**
 * Share of the picture's side around it in which Gaussians of a view are asked for, too: the camera may turn before
 * others are there.
 */
const MARGIN = 0.25;

/** The camera of a pose that is in units of `size`, for a picture of this size. */
export function cameraOf({ position, rotation }: Pose, size: number, width: number, height: number): Camera {
  const row = (x: number, y: number, z: number): number[] => {
    const axis = rotation.transformVector(new Vec3(x, y, z), new Vec3());
    return [axis.x, axis.y, axis.z, -(axis.x * position.x + axis.y * position.y + axis.z * position.z) * size];
  };
  const focal = height / 2 / Math.tan((FIELD_OF_VIEW * Math.PI) / 360);
  return {
    viewmat: [row(1, 0, 0), row(0, -1, 0), row(0, 0, -1)],
    focal,
    width,
    height,
    margin: MARGIN * Math.max(width, height),
  };
}

export class Orbit {
  target = new Vec3();
  distance = 3;
  yaw = 0.5;
  pitch = -0.25;
  /** Whether what `base` calls up is down: a person's choice, which holds wherever the scene begins. */
  turned = false;
  /**
   * Turns the y axis to what is up: y is down in scenes, as it is for the cameras of 3DGS, until somebody says
   * otherwise.
   */
  base = UPSIDE_DOWN.clone();
  /** Whether it began where a stream said. */
  placed = false;
  /** Whether somebody moved it. */
  touched = false;
  /** Where it began. */
  #home = { target: new Vec3(), distance: 3, yaw: 0.5, pitch: -0.25 };
  readonly #pointers = new Map<number, { x: number; y: number }>();

  /** `changed` is called after every change by hand. */
  constructor(
    readonly canvas: HTMLElement,
    readonly changed: () => void,
  ) {
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      canvas.addEventListener(kind, (event) => this.#pointers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.#zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) * WHEEL));
      },
      { passive: false },
    );
  }

  /** Looks at a scene from outside. */
  frame(middle: readonly number[], radius: number): void {
    this.target.set(middle[0], middle[1], middle[2]);
    this.distance = radius * 2.6;
    this.#begins();
  }

  /** Begins at a place, looking at a point around which it turns. */
  place(eye: Vec3, target: Vec3, up: Vec3): void {
    this.base.setFromDirections(Vec3.UP, up.clone().normalize());
    const back = new Vec3().sub2(eye, target);
    this.target.copy(target);
    this.distance = back.length();
    this.base
      .clone()
      .invert()
      .transformVector(back.mulScalar(1 / this.distance), back);
    this.pitch = -Math.min(Math.max(Math.asin(Math.min(Math.max(back.y, -1), 1)), -STEEPEST), STEEPEST);
    this.yaw = Math.atan2(back.x, back.z);
    this.placed = true;
    this.#begins();
  }

  #begins(): void {
    const { target, distance, yaw, pitch } = this;
    this.#home = { target: target.clone(), distance, yaw, pitch };
  }

  /** Goes back to where it began. */
  home(): void {
    const { target, ...look } = this.#home;
    this.target.copy(target);
    Object.assign(this, look);
    this.#moved();
  }

  /** Has y up, or down, until a stream says what is up. */
  upIs(y: boolean): void {
    if (y) this.base.set(0, 0, 0, 1);
    else this.base.copy(UPSIDE_DOWN);
  }

  /** Units become so many times smaller. */
  rescale(factor: number): void {
    this.target.mulScalar(factor);
    this.distance *= factor;
    this.#home.target.mulScalar(factor);
    this.#home.distance *= factor;
  }

  /** Turns the scene upside down. */
  flip(): void {
    this.turned = !this.turned;
    this.changed();
  }

  pose(): Pose {
    const rotation = new Quat().setFromEulerAngles((this.pitch * 180) / Math.PI, (this.yaw * 180) / Math.PI, 0);
    if (this.turned) rotation.mul2(UPSIDE_DOWN, rotation);
    rotation.mul2(this.base, rotation);
    const back = rotation.transformVector(new Vec3(0, 0, this.distance), new Vec3());
    return { position: back.add(this.target), rotation };
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
    if (turn && shift) this.#pan(30 * turn[0], 30 * turn[1]);
    else if (turn) this.#turn(-turn[0] * KEY_TURN, turn[1] * KEY_TURN);
    else if (key === "+" || key === "=") this.#zoom(KEY_ZOOM);
    else if (key === "-") this.#zoom(1 / KEY_ZOOM);
    else if (key === "Home") this.home();
    else return false;
    return true;
  }

  #moved(): void {
    this.touched = true;
    this.changed();
  }

  #down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  #move(event: PointerEvent): void {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.x,
      dy = event.clientY - before.y,
      others = [...this.#pointers.entries()].filter(([id]) => id !== event.pointerId);
    if (others.length) {
      const other = others[0][1],
        far = (x: number, y: number): number => Math.max(Math.hypot(x - other.x, y - other.y), 1);
      this.#zoom(far(before.x, before.y) / far(event.clientX, event.clientY));
      this.#pan(dx / 2, dy / 2);
    } else if (event.buttons & 2 || event.shiftKey) this.#pan(dx, dy);
    else this.#turn(-dx * TURN, -dy * TURN);
    this.#pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  #turn(yaw: number, pitch: number): void {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, -STEEPEST), STEEPEST);
    this.#moved();
  }

  #zoom(factor: number): void {
    this.distance = Math.min(Math.max(this.distance * factor, 1e-3), 1e4);
    this.#moved();
  }

  #pan(dx: number, dy: number): void {
    const { rotation } = this.pose(),
      step = (this.distance * 1.2) / Math.max(this.canvas.clientHeight, 1);
    this.target.add(rotation.transformVector(new Vec3(-dx * step, dy * step, 0), new Vec3()));
    this.#moved();
  }
}
