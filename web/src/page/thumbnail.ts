// Element <splat-wire-preview data="..." viewpoint="...">: a thumbnail painted from a preview, for lists of scenes.

import { Vec3 } from "playcanvas";

import { fromBase64 } from "../bytes.ts";
import { frameScene, sceneCore } from "../render/framing.ts";
import { FreeSpace } from "../render/free_space.ts";
import { Orbit } from "../render/orbit.ts";
import { packPreview } from "../render/packed_preview.ts";
import { halfHeight } from "../render/projection.ts";
import { paint } from "../render/software_renderer.ts";
import { periodicPause } from "../scheduler.ts";
import { Base } from "./base.ts";
import { viewpointOf } from "./links.ts";

export class Thumbnail extends Base {
  connectedCallback(): void {
    const canvas = document.createElement("canvas");
    this.replaceChildren(canvas);
    this.#paint(canvas).catch(() => canvas.remove()); // such as of an invalid preview
  }

  async #paint(canvas: HTMLCanvasElement): Promise<void> {
    const bytes = fromBase64(this.getAttribute("data") ?? ""),
      { packed, background, size } = packPreview(bytes),
      parts = [packed],
      scaled = (point: readonly number[]): Vec3 => new Vec3(...point.map((value) => value / size)),
      orbit = new Orbit(() => undefined),
      viewpoint = viewpointOf(this.getAttribute("viewpoint"));
    orbit.setUp(this.getAttribute("up") ?? "");
    if (viewpoint) {
      const { eye, target, up } = viewpoint;
      orbit.place(scaled(eye), scaled(target), new Vec3(...up));
    } else {
      const core = sceneCore(parts),
        down = halfHeight(canvas.clientWidth, canvas.clientHeight),
        across = (down * canvas.clientWidth) / Math.max(canvas.clientHeight, 1);
      frameScene(orbit, core, new FreeSpace(core, parts), across, down);
    }
    await paint(canvas, { parts, background, pose: orbit.pose() }, periodicPause());
  }
}
