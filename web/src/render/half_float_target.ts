// Render target with 16 bits per channel, or 10 (alpha: 2) where half floats are not renderable. A canvas would round
// hundreds of thin layers to eight bits and clamp intermediate sums at 1, which costs 6 to 14 dB.

import {
  type CameraComponent,
  PIXELFORMAT_RGB10A2,
  PIXELFORMAT_RGBA16F,
  RenderTarget,
  Texture,
  type WebglGraphicsDevice,
} from "playcanvas";

/** Half-float render target, copied to the canvas after each frame. */
export class HalfFloatTarget {
  #target: RenderTarget | null = null;

  constructor(
    readonly device: WebglGraphicsDevice,
    readonly camera: CameraComponent,
  ) {}

  resize(width: number, height: number): void {
    if (this.#target?.width === width && this.#target.height === height) return;
    this.destroy();
    const format = this.device.textureHalfFloatRenderable ? PIXELFORMAT_RGBA16F : PIXELFORMAT_RGB10A2,
      colorBuffer = new Texture(this.device, { name: "precise", width, height, format, mipmaps: false });
    this.#target = new RenderTarget({ name: "precise", colorBuffer, depth: true });
    this.camera.renderTarget = this.#target;
  }

  /** Sets whether the camera draws into this target; otherwise it draws into the canvas or a headset. */
  set used(used: boolean) {
    const { gl } = this.device;
    if (!used) gl.bindFramebuffer(gl.FRAMEBUFFER, null); // copies leave the target bound without the engine's knowledge
    this.camera.renderTarget = (used ? this.#target : null) as RenderTarget; // the engine takes null, its types do not
  }

  /** Copies the picture to the canvas. */
  show(): void {
    const { renderTarget } = this.camera;
    if (renderTarget) this.device.copyRenderTarget(renderTarget, undefined, true, false);
  }

  destroy(): void {
    this.#target?.destroyTextureBuffers();
    this.#target?.destroy();
    this.#target = null;
  }
}
