// WebGL device that never waits for the linker of shaders, which would block the page for as long as linking takes.

import { type Shader, WebglGraphicsDevice } from "playcanvas";

/** Internals of PlayCanvas: called before each draw. */
interface Activation {
  activateShader(): void;
}
const base = WebglGraphicsDevice.prototype as unknown as Activation;

export class AsyncShaderDevice extends WebglGraphicsDevice {
  #skipped = false;

  /** Uses a shader. Draws are skipped until it is linked. */
  override setShader(shader: Shader): void {
    super.setShader(shader, true);
  }

  activateShader(): void {
    if (this.shaderValid === false) this.shaderValid = undefined; // may be linked now
    base.activateShader.call(this);
    if (!this.shaderValid && !this.shader?.failed) this.#skipped = true;
  }

  /** Returns true if a draw was skipped since the last call, so that the picture is incomplete. */
  takeSkipped(): boolean {
    const skipped = this.#skipped;
    this.#skipped = false;
    return skipped;
  }
}
