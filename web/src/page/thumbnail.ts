// <splat-wire-preview data="..." viewpoint="...">: a small picture of a preview, for lists of scenes.

import { Vec3 } from "playcanvas";

import { readPreview } from "../codec/preview.ts";
import { coreOf, frameScene } from "../render/framing.ts";
import { tangentOf } from "../render/lens.ts";
import { Orbit } from "../render/orbit.ts";
import { pack } from "../render/packed.ts";
import { paint } from "../render/painter.ts";
import { Space } from "../render/space.ts";
import { viewpointOf } from "./links.ts";

export class Thumbnail extends HTMLElement {
  connectedCallback(): void {
    const canvas = document.createElement("canvas");
    this.replaceChildren(canvas);
    try {
      this.#paint(canvas);
    } catch {
      canvas.remove(); // one that is no preview is nothing to fail for
    }
  }

  #paint(canvas: HTMLCanvasElement): void {
    const bytes = Uint8Array.from(atob(this.getAttribute("data") ?? ""), (c) => c.charCodeAt(0)),
      { splats, background } = readPreview(bytes),
      parts = [pack([splats], 0, 1)],
      orbit = new Orbit(() => undefined),
      viewpoint = viewpointOf(this.getAttribute("viewpoint"));
    orbit.upIs(this.getAttribute("up") ?? "");
    if (viewpoint) {
      const { eye, target, up } = viewpoint;
      orbit.place(new Vec3(...eye), new Vec3(...target), new Vec3(...up));
    } else {
      const core = coreOf(parts),
        down = tangentOf(canvas.clientWidth, canvas.clientHeight),
        across = (down * canvas.clientWidth) / Math.max(canvas.clientHeight, 1);
      frameScene(orbit, core, new Space(core, parts), across, down);
    }
    paint(canvas, { parts, background, pose: orbit.pose() });
  }
}
