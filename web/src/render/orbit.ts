// A camera that turns around a point: mouse, touch and keys.

import { Quat, Vec3 } from "playcanvas";

import type { Camera } from "../model/camera.ts";
import type { Space } from "./space.ts";

const TURN = 0.005,
  KEY_TURN = 0.08,
  KEY_ZOOM = 0.9,
  WHEEL = 0.0012,
  STEEPEST = 1.55;
const UPSIDE_DOWN = new Quat().setFromEulerAngles(0, 0, 180);

/** Field of view, degrees: down, unless that is too narrow across. */
const DOWN = 50,
  ACROSS = 40,
  MOST_DOWN = 90;

/** Half of what a window shows at distance 1, downwards. */
export function tangentOf(width: number, height: number): number {
  const half = (degrees: number): number => Math.tan((degrees * Math.PI) / 360);
  return Math.min(Math.max(half(DOWN), (half(ACROSS) * height) / Math.max(width, 1)), half(MOST_DOWN));
}

/** What is up, by the words of streams and pages. */
const UPS: Record<string, [number, number, number]> = {
  x: [1, 0, 0],
  "-x": [-1, 0, 0],
  y: [0, 1, 0],
  z: [0, 0, 1],
  "-z": [0, 0, -1],
};

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
  const focal = height / 2 / tangentOf(width, height);
  return {
    viewmat: [row(1, 0, 0), row(0, -1, 0), row(0, 0, -1)],
    focal,
    width,
    height,
    margin: MARGIN * Math.max(width, height),
  };
}

/** Where it begins where nobody says it, radians. */
const USUAL = { yaw: 0.5, pitch: -0.25 };
/** Farthest from a scene, and nearest to the point around which it turns, over the scene's radius. */
const FARTHEST = 8,
  NEAREST = 0.02;
/** Nearer to what is pointed at. */
const FOCUS = 0.6;

interface State {
  readonly target: Vec3;
  readonly distance: number;
  readonly yaw: number;
  readonly pitch: number;
}

export class Orbit {
  readonly usual = USUAL;
  target = new Vec3();
  distance = 3;
  yaw = USUAL.yaw;
  pitch = USUAL.pitch;
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
  #home: State = this.#state();
  readonly #pointers = new Map<number, { x: number; y: number }>();

  /** `changed` is called after every change by hand; `space` says where it may be, and null where all is free. */
  constructor(
    readonly canvas: HTMLElement,
    readonly changed: () => void,
    readonly space: () => Space | null = () => null,
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

  /** Begins at a distance from a point. */
  begin(target: readonly number[], distance: number, yaw = this.yaw): void {
    this.target.set(target[0], target[1], target[2]);
    Object.assign(this, { distance, yaw });
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
    this.#home = this.#state();
  }

  #state(): State {
    const { target, distance, yaw, pitch } = this;
    return { target: target.clone(), distance, yaw, pitch };
  }

  /** Goes back to where it began. */
  home(): void {
    this.#set(this.#home);
    this.touched = true;
    this.changed();
  }

  #set({ target, ...look }: State): void {
    this.target.copy(target);
    Object.assign(this, look);
  }

  /** Says what is up: `y`, `-z`, ...; y is down where it is none of these. */
  upIs(up: string): void {
    if (up in UPS) this.base.setFromDirections(Vec3.UP, new Vec3(...UPS[up]));
    else this.base.copy(UPSIDE_DOWN);
  }

  /** Units become so many times smaller. */
  rescale(factor: number): void {
    this.target.mulScalar(factor);
    this.distance *= factor;
    const { target, distance, ...look } = this.#home;
    this.#home = { target: target.mulScalar(factor), distance: distance * factor, ...look };
  }

  /** Turns the scene upside down. */
  flip(): void {
    this.turned = !this.turned;
    this.changed();
  }

  /** How a camera is turned that looks there. */
  rotation(yaw: number, pitch: number): Quat {
    const rotation = new Quat().setFromEulerAngles((pitch * 180) / Math.PI, (yaw * 180) / Math.PI, 0);
    if (this.turned) rotation.mul2(UPSIDE_DOWN, rotation);
    return rotation.mul2(this.base, rotation);
  }

  pose(): Pose {
    const rotation = this.rotation(this.yaw, this.pitch);
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

  /** Turns around a point from here on, from nearer than its depth. */
  focus(point: Vec3, depth: number): void {
    this.#moves(() => {
      this.target.copy(point);
      this.distance = FOCUS * depth;
    });
  }

  /** Moves as far as there is room; `turns` around the point. */
  #moves(move: () => void, turns = false): void {
    const space = this.space(),
      before = this.#state(),
      began = this.#eye();
    this.touched = true;
    move();
    if (space) {
      this.#hold(space);
      if (space.free(began)) turns ? this.#pullsIn(space, before) : this.#stops(space, before, began);
    }
    this.changed();
  }

  #eye(): [number, number, number] {
    const { x, y, z } = this.pose().position;
    return [x, y, z];
  }

  /** Keeps what it turns around within the scene, and the scene in sight. */
  #hold({ middle, radius }: Space): void {
    const home = this.#home,
      centre = new Vec3(middle[0], middle[1], middle[2]),
      reach = Math.max(radius, home.target.distance(centre)),
      away = new Vec3().sub2(this.target, centre);
    if (away.length() > reach) this.target.copy(away.mulScalar(reach / away.length()).add(centre));
    const most = Math.max(FARTHEST * radius, home.distance);
    this.distance = Math.min(Math.max(this.distance, Math.min(NEAREST * radius, home.distance)), most);
  }

  /** Comes nearer where something is in the way of a turn; turns not where that does not help. */
  #pullsIn(space: Space, before: State): void {
    for (let n = 0; n < 12; n++, this.distance *= 0.9) if (space.free(this.#eye())) return;
    this.#set(before);
  }

  /** Goes from where it was as far as it is free. */
  #stops(space: Space, before: State, began: readonly number[]): void {
    const after = this.#state(),
      end = this.#eye(),
      length = Math.hypot(...end.map((value, a) => value - began[a])),
      steps = Math.min(Math.max(Math.ceil((2 * length) / space.cell), 1), 64),
      mix = (one: number, other: number, share: number): number => one + (other - one) * share;
    let last = before;
    for (let n = 1; n <= steps; n++) {
      const share = n / steps;
      this.#set({
        target: new Vec3().lerp(before.target, after.target, share),
        distance: mix(before.distance, after.distance, share),
        yaw: mix(before.yaw, after.yaw, share),
        pitch: mix(before.pitch, after.pitch, share),
      });
      if (!space.free(this.#eye())) break;
      last = this.#state();
    }
    this.#set(last);
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
    this.#moves(() => {
      this.yaw += yaw;
      this.pitch = Math.min(Math.max(this.pitch + pitch, -STEEPEST), STEEPEST);
    }, true);
  }

  #zoom(factor: number): void {
    this.#moves(() => (this.distance = Math.min(Math.max(this.distance * factor, 1e-3), 1e4)));
  }

  #pan(dx: number, dy: number): void {
    const { rotation } = this.pose(),
      step = (this.distance * 1.2) / Math.max(this.canvas.clientHeight, 1);
    this.#moves(() => this.target.add(rotation.transformVector(new Vec3(-dx * step, dy * step, 0), new Vec3())));
  }
}
