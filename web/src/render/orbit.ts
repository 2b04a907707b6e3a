// Orbit camera with collision limits.

import { Quat, Vec3 } from "playcanvas";
import type { FreeSpace } from "./free_space.ts";
import type { Pose } from "./projection.ts";

const MAX_PITCH = 1.55,
  /** Approximate height of the window's content relative to the distance. */
  WINDOW_HEIGHT = 1.2;
/** Cosine of the angle above which two up axes are different. */
const SAME_AXIS = 0.9999;
const UPSIDE_DOWN = new Quat().setFromEulerAngles(0, 0, 180);

/** Up vectors by name. */
const UP_VECTORS: Record<string, [number, number, number]> = {
  x: [1, 0, 0],
  "-x": [-1, 0, 0],
  y: [0, 1, 0],
  z: [0, 0, 1],
  "-z": [0, 0, -1],
};

/** Default direction, radians. */
const DEFAULT_DIRECTION = { yaw: 0.5, pitch: -0.25 };
/** Largest distance from the scene and smallest distance from the target, relative to the scene's radius. */
const MAX_DISTANCE = 8,
  MIN_DISTANCE = 0.02;
/**
 * Smallest distance when zooming in, relative to the local density radius, and its upper bound relative to the scene's
 * radius.
 */
const MIN_ZOOM_RADII = 5,
  MAX_MIN_ZOOM = 0.3;
/** Limits of the distance before the scene is known. */
const MIN_UNKNOWN_DISTANCE = 1e-3,
  MAX_UNKNOWN_DISTANCE = 1e4;
/** Distance factor of a double click. */
const FOCUS_FACTOR = 0.6;

/** Position in a window, CSS pixels from the upper left corner. */
export interface WindowPosition {
  readonly x: number;
  readonly y: number;
}

/** Camera relative to the up axis: target, distance to it, and angles in radians. */
export interface OrbitState {
  readonly target: Vec3;
  readonly distance: number;
  readonly yaw: number;
  readonly pitch: number;
}

/** Limits of the page: distances from the target in units of the view, and pitches in radians. */
export interface OrbitLimits {
  readonly near: number;
  readonly far: number;
  readonly low: number;
  readonly high: number;
}

const NO_LIMITS: OrbitLimits = { near: 0, far: Infinity, low: -MAX_PITCH, high: MAX_PITCH };

/** Returns a state between two others, on the shorter way around the up axis. */
function between(from: OrbitState, to: OrbitState, share: number): OrbitState {
  if (share === 1) return to; // from far away, the sums are inexact
  const mix = (one: number, other: number): number => one + (other - one) * share,
    turn = Math.atan2(Math.sin(to.yaw - from.yaw), Math.cos(to.yaw - from.yaw));
  return {
    target: new Vec3().lerp(from.target, to.target, share),
    distance: mix(from.distance, to.distance),
    yaw: from.yaw + turn * share,
    pitch: mix(from.pitch, to.pitch),
  };
}

export class Orbit {
  readonly defaultDirection = DEFAULT_DIRECTION;
  target = new Vec3();
  distance = 3;
  yaw = DEFAULT_DIRECTION.yaw;
  pitch = DEFAULT_DIRECTION.pitch;
  /** True if the visitor turned the scene upside down, relative to `base`. */
  turned = false;
  /** Rotation from the y axis to the scene's up axis. The default has y down, as in 3DGS cameras. */
  upRotation = UPSIDE_DOWN.clone();
  /** True if the page or the stream set the viewpoint. */
  placed = false;
  /** True if the visitor moved the camera. */
  touched = false;
  /** Initial state. */
  #initial: OrbitState = this.state;
  /** Angle of the automatic rotation since the viewpoint was set, radians. */
  #drifted = 0;
  #limits = NO_LIMITS;
  /** Point that the camera zooms towards, its smallest distance, and its window position. */
  #zoomTarget: { readonly point: Vec3; readonly near: number; readonly at: string } | null = null;

  /**
   * `changed` is called after every movement. `space` returns the free space for the camera, or null without limits.
   * `pick` returns the point of the scene at a window position (null is the centre), or next to it.
   */
  constructor(
    readonly changed: () => void,
    readonly space: () => FreeSpace | null = () => null,
    readonly pick: (at: WindowPosition | null) => Vec3 | null = () => null,
  ) {}

  /** Sets the initial state: a target, a distance and a yaw. The automatic rotation so far is then repeated. */
  begin(target: readonly number[], distance: number, yaw = this.yaw - this.#drifted): void {
    this.target = new Vec3(...target);
    Object.assign(this, { distance, yaw });
    this.#storeInitial();
    const drifted = this.#drifted;
    this.#drifted = 0;
    if (drifted) this.drift(drifted); // stops at obstacles
  }

  /** Sets the initial state: an eye position, a target and an up vector. */
  place(eye: Vec3, target: Vec3, up: Vec3): void {
    this.upRotation.setFromDirections(Vec3.UP, up.clone().normalize());
    this.#restore(this.stateOf(eye, target, false));
    this.placed = true;
    this.#drifted = 0;
    this.#storeInitial();
  }

  /** Sets the up axis without moving the eye or the target. */
  reorient(up: Vec3): void {
    const { eye, target, up: before } = this.viewpoint();
    if (before.dot(up) > SAME_AXIS) return;
    this.turned = false;
    this.upRotation.setFromDirections(Vec3.UP, up);
    this.#restore(this.stateOf(eye, target));
  }

  /** Returns the state with an eye position and a target. The direction stays if both are the same point. */
  stateOf(eye: Vec3, target: Vec3, turned = this.turned): OrbitState {
    const back = new Vec3().sub2(eye, target),
      distance = back.length(),
      turn = this.upRotation.clone().invert();
    if (!(distance > 0 && distance < Infinity)) return { ...this.state, target: target.clone() };
    if (turned) turn.mul2(UPSIDE_DOWN, turn);
    turn.transformVector(back.mulScalar(1 / distance), back);
    const pitch = -Math.min(Math.max(Math.asin(Math.min(Math.max(back.y, -1), 1)), -MAX_PITCH), MAX_PITCH);
    return { target: target.clone(), distance, yaw: Math.atan2(back.x, back.z), pitch };
  }

  #storeInitial(): void {
    this.#initial = this.state; // without the limits, which the page may change
    this.#applyLimits();
  }

  get state(): OrbitState {
    const { target, distance, yaw, pitch } = this;
    return { target: target.clone(), distance, yaw, pitch };
  }

  /** Sets the limits of the page, or removes them. */
  limit(limits: OrbitLimits | null): void {
    this.#limits = limits ?? NO_LIMITS;
    this.#applyLimits();
  }

  #applyLimits(): void {
    const { near, far, low, high } = this.#limits;
    this.distance = Math.min(Math.max(this.distance, near), far);
    this.pitch = Math.min(Math.max(this.pitch, low), high);
  }

  /** Moves to a state between two others, 0 to 1, on the shorter way around the up axis. Obstacles are ignored. */
  moveBetween(from: OrbitState, to: OrbitState, share: number): void {
    this.#restore(between(from, to, share));
    this.touched = true;
    this.#applyLimits();
    this.changed();
  }

  /** Returns to the initial state. */
  reset(): void {
    this.#restore(this.#initial);
    this.#applyLimits();
    this.touched = true;
    this.changed();
  }

  #restore({ target, ...look }: OrbitState): void {
    this.target.copy(target);
    Object.assign(this, look);
  }

  /** Sets the up axis: `x`, `-x`, `y`, `z` or `-z`; y is down for any other value. */
  setUp(up: string): void {
    if (up in UP_VECTORS) this.upRotation.setFromDirections(Vec3.UP, new Vec3(...UP_VECTORS[up]));
    else this.upRotation.copy(UPSIDE_DOWN);
  }

  /** Changes the unit of length by a factor. */
  rescale(factor: number): void {
    this.target.mulScalar(factor);
    this.distance *= factor;
    const { near, far, ...angles } = this.#limits;
    this.#limits = { near: near * factor, far: far * factor, ...angles };
    const { target, distance, ...look } = this.#initial;
    this.#initial = { target: target.mulScalar(factor), distance: distance * factor, ...look };
  }

  /** Rotates without input of the visitor, by an angle in radians. */
  drift(yaw: number): void {
    const { touched, yaw: before } = this;
    this.rotate(yaw, 0);
    this.touched = touched;
    this.#drifted += this.yaw - before;
  }

  /** Returns the eye, the target and the up axis. */
  viewpoint(): { eye: Vec3; target: Vec3; up: Vec3 } {
    const up = this.upRotation.transformVector(this.turned ? Vec3.DOWN : Vec3.UP, new Vec3());
    return { eye: this.pose().position, target: this.target.clone(), up };
  }

  /** Turns the scene upside down. */
  flip(): void {
    this.turned = !this.turned;
    this.changed();
  }

  /** Returns the camera rotation for a direction. */
  rotation(yaw: number, pitch: number): Quat {
    const rotation = new Quat().setFromEulerAngles((pitch * 180) / Math.PI, (yaw * 180) / Math.PI, 0);
    if (this.turned) rotation.mul2(UPSIDE_DOWN, rotation);
    return rotation.mul2(this.upRotation, rotation);
  }

  pose(): Pose {
    const rotation = this.rotation(this.yaw, this.pitch);
    const back = rotation.transformVector(new Vec3(0, 0, this.distance), new Vec3());
    return { position: back.add(this.target), rotation };
  }

  /** Makes the point at a window position the target and moves closer. */
  focus(at: WindowPosition): void {
    const found = this.#pickPoint(at, "");
    if (!found) return;
    this.#moveWithin(() => {
      const away = this.pose().position.distance(found.point);
      this.distance = Math.max(FOCUS_FACTOR * away, Math.min(found.near, away));
      this.target.copy(found.point);
    });
  }

  /** Moves as far as the free space allows. `turns` marks rotations around the target. */
  #moveWithin(move: () => void, turns = false): void {
    const space = this.space(),
      before = this.state,
      began = this.#position();
    this.touched = true;
    this.#zoomTarget = null;
    move();
    this.#applyLimits();
    if (space) {
      this.#clampToScene(space);
      this.#applyLimits();
      if (space.isFree(began))
        turns ? this.#shortenDistance(space, before) : this.#stopAtObstacle(space, before, began);
    }
    this.changed();
  }

  #position(): [number, number, number] {
    const { x, y, z } = this.pose().position;
    return [x, y, z];
  }

  /** Keeps the target within the scene, and the distance within its limits. */
  #clampToScene({ middle, radius }: FreeSpace): void {
    const home = this.#initial,
      centre = new Vec3(...middle),
      reach = Math.max(radius, home.target.distance(centre)),
      away = new Vec3().sub2(this.target, centre);
    if (away.length() > reach) this.target.copy(away.mulScalar(reach / away.length()).add(centre));
    const most = Math.max(MAX_DISTANCE * radius, home.distance);
    this.distance = Math.min(Math.max(this.distance, Math.min(MIN_DISTANCE * radius, home.distance)), most);
  }

  /** Shortens the distance if a rotation is blocked, or undoes the rotation. */
  #shortenDistance(space: FreeSpace, before: OrbitState): void {
    for (let n = 0; n < 12; n++, this.distance *= 0.9) if (space.isFree(this.#position())) return;
    this.#restore(before);
  }

  /** Moves along the straight path up to the first obstacle. */
  #stopAtObstacle(space: FreeSpace, before: OrbitState, began: readonly number[]): void {
    const after = this.state,
      end = this.#position(),
      length = Math.hypot(...end.map((value, a) => value - began[a])),
      steps = Math.min(Math.max(Math.ceil((2 * length) / space.cell), 1), 64);
    let last = before;
    for (let n = 1; n <= steps; n++) {
      this.#restore(between(before, after, n / steps));
      if (!space.isFree(this.#position())) break;
      last = this.state;
    }
    this.#restore(last);
  }

  /** Rotates by angles in radians. */
  rotate(yaw: number, pitch: number): void {
    this.#moveWithin(() => {
      this.yaw = (this.yaw + yaw) % (2 * Math.PI);
      this.pitch = Math.min(Math.max(this.pitch + pitch, -MAX_PITCH), MAX_PITCH);
    }, true);
  }

  /** Moves sideways by fractions of the window's height. Undone if no part of the scene stays in view. */
  pan(dx: number, dy: number): void {
    const before = this.state,
      step = this.distance * WINDOW_HEIGHT,
      across = this.pose().rotation.transformVector(new Vec3(-dx * step, dy * step, 0), new Vec3()),
      something = this.#sceneInView();
    this.#moveWithin(() => this.target.add(across));
    if (something && !this.#sceneInView()) this.#restore(before);
  }

  /** Multiplies the distance by a factor. Zooming in moves towards the point at a window position. */
  zoom(factor: number, at: WindowPosition | null = null): void {
    if (factor < 1) this.#approach(factor, at);
    else this.#scale(factor);
  }

  #scale(factor: number): void {
    this.#moveWithin(
      () => (this.distance = Math.min(Math.max(this.distance * factor, MIN_UNKNOWN_DISTANCE), MAX_UNKNOWN_DISTANCE)),
    );
  }

  /** Moves towards a point, which shifts to the centre of the window. Stops at the smallest useful distance. */
  #approach(factor: number, at: WindowPosition | null): void {
    const key = String(at && [at.x, at.y]),
      towards = this.#zoomTarget?.at === key ? this.#zoomTarget : this.#pickPoint(at, key);
    if (!towards) return this.#scale(factor);
    const { position, rotation } = this.pose(),
      back = rotation.transformVector(new Vec3(0, 0, 1), new Vec3()),
      depth = new Vec3().sub2(position, towards.point).dot(back),
      nearer = Math.max(factor, towards.near / depth);
    if (nearer >= 1) return;
    this.#moveWithin(() => {
      this.target.sub2(position, back.mulScalar(depth));
      this.target.lerp(towards.point, this.target, nearer ** 2);
      this.distance = depth * nearer;
    });
    this.#zoomTarget = towards;
  }

  #pickPoint(at: WindowPosition | null, key: string): { point: Vec3; near: number; at: string } | null {
    const point = this.pick(at),
      space = this.space();
    if (!point) return null;
    const grain = space?.densityRadius([point.x, point.y, point.z]) ?? 0,
      near = Math.min(MIN_ZOOM_RADII * grain, MAX_MIN_ZOOM * (space?.radius ?? 0));
    return { point, near, at: key };
  }

  /** Returns true if part of the scene is in view. */
  #sceneInView(): boolean {
    const { position, rotation } = this.pose(),
      { x, y, z } = rotation.transformVector(Vec3.FORWARD, new Vec3());
    return this.space()?.sceneInView([position.x, position.y, position.z], [x, y, z]) ?? true;
  }
}
