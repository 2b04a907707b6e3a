// Virtual reality (WebXR): draws the scene for both eyes of a headset, from the camera's position on the page.

import { type AppBase, Entity, Quat, Vec3, XRSPACE_LOCAL, XRTYPE_VR, XrManager } from "playcanvas";

import type { Orbit } from "./orbit.ts";
import type { Pose } from "./projection.ts";

/** Distance from the eyes to the camera's target at the start, metres. It determines the size of the scene. */
const TARGET_M = 2;

/** Internals of PlayCanvas: the types of sessions that it starts. */
interface XrInternals {
  readonly _available: Record<string, boolean>;
}

export class Headset {
  /** Parent of the camera. During a session it has the position, direction and size of the visitor. */
  readonly #visitor: Entity;
  /** True during a session. */
  active = false;

  /** `changed` is called after the start and the end of a session. */
  constructor(
    readonly app: AppBase,
    readonly camera: Entity,
    readonly orbit: Orbit,
    readonly changed: () => void,
  ) {
    this.#visitor = new Entity("visitor", app);
    app.root.addChild(this.#visitor);
    this.#visitor.addChild(camera);
  }

  /** Starts a session. Throws if the browser refuses it. */
  start(): Promise<void> {
    const xr = (this.app.xr ??= this.#createManager());
    return new Promise((resolve, reject) =>
      xr.start(this.camera.camera!, XRTYPE_VR, XRSPACE_LOCAL, {
        callback: (error) => {
          if (error) return reject(error);
          this.#enter();
          resolve();
        },
      }),
    );
  }

  /**
   * Creates PlayCanvas's manager of sessions. It uses WebXR at once, and Chromium keeps no page that has used WebXR for
   * the back button. The page has found out that sessions are supported.
   */
  #createManager(): XrManager {
    const xr = new XrManager(this.app);
    (xr as unknown as XrInternals)._available[XRTYPE_VR] = true;
    xr.on("end", () => this.#leave());
    return xr;
  }

  /** Pose of the visitor's head. */
  get pose(): Pose {
    return { position: this.camera.getPosition(), rotation: this.camera.getRotation() };
  }

  /** Puts the visitor where the page's camera is. The view is level: the visitor's head has its own inclination. */
  #enter(): void {
    const { position } = this.orbit.pose(),
      level = this.orbit.rotation(this.orbit.yaw, 0),
      size = this.orbit.distance / TARGET_M;
    // as numbers, because the page's vectors are of another class than the engine's
    this.#visitor.setPosition(position.x, position.y, position.z);
    this.#visitor.setRotation(level.x, level.y, level.z, level.w);
    this.#visitor.setLocalScale(size, size, size);
    this.active = this.app.autoRender = true;
    this.changed();
  }

  #leave(): void {
    this.#visitor.setPosition(Vec3.ZERO);
    this.#visitor.setRotation(Quat.IDENTITY);
    this.#visitor.setLocalScale(Vec3.ONE);
    this.active = this.app.autoRender = false;
    this.changed();
  }
}
