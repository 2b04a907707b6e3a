// A camera that turns around a point, and where it may go.

import { Quat, Vec3 } from "playcanvas";

import type { Pose } from "./lens.ts";
import type { Space } from "./space.ts";

const STEEPEST = 1.55,
  /** Of the distance: what a window's height shows of what is there, about. */
  HEIGHT = 1.2;
const UPSIDE_DOWN = new Quat().setFromEulerAngles(0, 0, 180);

/** What is up, by the words of streams and pages. */
const UPS: Record<string, [number, number, number]> = {
  x: [1, 0, 0],
  "-x": [-1, 0, 0],
  y: [0, 1, 0],
  z: [0, 0, 1],
  "-z": [0, 0, -1],
};

/** Where it begins where nobody says it, radians. */
const USUAL = { yaw: 0.5, pitch: -0.25 };
/** Farthest from a scene, and nearest to the point around which it turns, over the scene's radius. */
const FARTHEST = 8,
  NEAREST = 0.02;
/**
 * Nearest to what it comes nearer to: over the radius of the Gaussians around that, but over the scene's where there
 * are only few.
 */
const NEAR = 5,
  NEAR_FEW = 0.3;
/** Distances where nothing of a scene is known yet. */
const LEAST = 1e-3,
  MOST = 1e4;
/** Nearer to what is pointed at. */
const FOCUS = 0.6;

/** A place of a window, CSS pixels from its upper left corner. */
export interface Place {
  readonly x: number;
  readonly y: number;
}

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
  /** What it comes nearer to, how near, and at which place of the window it was seen. */
  #towards: { readonly point: Vec3; readonly near: number; readonly at: string } | null = null;

  /**
   * `changed` is called after every change by hand; `space` says where it may be, and null where all is free; `seen`
   * says what is at a place of the window (CSS pixels; null is its middle), or next to it.
   */
  constructor(
    readonly changed: () => void,
    readonly space: () => Space | null = () => null,
    readonly seen: (at: Place | null) => Vec3 | null = () => null,
  ) {}

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

  /** Turns around what is at a place of the window from here on, from nearer. */
  focus(at: Place): void {
    const found = this.#found(at, "");
    if (!found) return;
    this.#moves(() => {
      const away = this.pose().position.distance(found.point);
      this.distance = Math.max(FOCUS * away, Math.min(found.near, away));
      this.target.copy(found.point);
    });
  }

  /** Moves as far as there is room; `turns` around the point. */
  #moves(move: () => void, turns = false): void {
    const space = this.space(),
      before = this.#state(),
      began = this.#eye();
    this.touched = true;
    this.#towards = null;
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

  /** Turns by angles, radians. */
  turn(yaw: number, pitch: number): void {
    this.#moves(() => {
      this.yaw += yaw;
      this.pitch = Math.min(Math.max(this.pitch + pitch, -STEEPEST), STEEPEST);
    }, true);
  }

  /** Moves across, by shares of the window's height; not to where nothing is in sight. */
  pan(dx: number, dy: number): void {
    const before = this.#state(),
      step = this.distance * HEIGHT,
      across = this.pose().rotation.transformVector(new Vec3(-dx * step, dy * step, 0), new Vec3()),
      something = this.#something();
    this.#moves(() => this.target.add(across));
    if (something && !this.#something()) this.#set(before);
  }

  /** Becomes so many times as far away; where that is nearer, from what is seen at a place of the window. */
  zoom(factor: number, at: Place | null = null): void {
    if (factor < 1) this.#approach(factor, at);
    else this.#scale(factor);
  }

  #scale(factor: number): void {
    this.#moves(() => (this.distance = Math.min(Math.max(this.distance * factor, LEAST), MOST)));
  }

  /**
   * Goes towards what is seen, which comes to the middle of the window, until the window is as wide as some
   * Gaussians.
   */
  #approach(factor: number, at: Place | null): void {
    const key = String(at && [at.x, at.y]),
      towards = this.#towards?.at === key ? this.#towards : this.#found(at, key);
    if (!towards) return this.#scale(factor);
    const { position, rotation } = this.pose(),
      back = rotation.transformVector(new Vec3(0, 0, 1), new Vec3()),
      depth = new Vec3().sub2(position, towards.point).dot(back),
      nearer = Math.max(factor, towards.near / depth);
    if (nearer >= 1) return;
    this.#moves(() => {
      this.target.sub2(position, back.mulScalar(depth));
      this.target.lerp(towards.point, this.target, nearer ** 2);
      this.distance = depth * nearer;
    });
    this.#towards = towards;
  }

  #found(at: Place | null, key: string): { point: Vec3; near: number; at: string } | null {
    const point = this.seen(at),
      space = this.space();
    if (!point) return null;
    const grain = space?.grain([point.x, point.y, point.z]) ?? 0,
      near = Math.min(NEAR * grain, NEAR_FEW * (space?.radius ?? 0));
    return { point, near, at: key };
  }

  /** Whether something is in sight. */
  #something(): boolean {
    const { position, rotation } = this.pose(),
      { x, y, z } = rotation.transformVector(Vec3.FORWARD, new Vec3());
    return this.space()?.ahead([position.x, position.y, position.z], [x, y, z]) ?? true;
  }
}
