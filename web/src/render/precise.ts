// Where Gaussians are blended: in sixteen bits a colour. A canvas rounds each of hundreds of thin layers to eight bits
// and cuts it at 1, though others may cover most of a bright one: 6 to 14 dB farther from the renderer's pictures.

import {
  type CameraComponent,
  PIXELFORMAT_RGB10A2,
  PIXELFORMAT_RGBA16F,
  RenderTarget,
  Texture,
  type WebglGraphicsDevice,
} from "playcanvas";

/** What a camera draws into, with more bits than the canvas that it is then copied to. */
export class Precise {
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

  /** Copies what was drawn to the canvas. */
  show(): void {
    if (this.#target) this.device.copyRenderTarget(this.#target, undefined, true, false);
  }

  destroy(): void {
    this.#target?.destroyTextureBuffers();
    this.#target?.destroy();
    this.#target = null;
  }
}
