// What the graphics card has to do still: who hands it more than it keeps up with has to wait, and the page with it.

import type { Texture, WebglGraphicsDevice } from "playcanvas";

interface Format {
  readonly _glFormat: number;
  readonly _glPixelType: number;
}

export class Card {
  #fence: WebGLSync | null = null;

  constructor(readonly device: WebglGraphicsDevice) {}

  /** Remembers what was handed over by now. */
  mark(): void {
    const { gl } = this.device;
    gl.deleteSync(this.#fence);
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  /** Whether that is done; a card that is lost does nothing any more. */
  get idle(): boolean {
    const { gl } = this.device;
    if (this.#fence && gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) === gl.UNSIGNALED) return false;
    gl.deleteSync(this.#fence);
    this.#fence = null;
    return true;
  }
}

/** A part of what one row after the other of a texture has: from the middle of a row on, whole rows, the last row. */
export interface Rectangle {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}

/** The rectangles in which texels from the first one until the end lie. */
export function rectangles(first: number, end: number, across: number): Rectangle[] {
  const found: Rectangle[] = [];
  for (let n = first; n < end; ) {
    const x = n % across,
      width = Math.min(across - x, end - n),
      height = x ? 1 : Math.max(Math.floor((end - n) / across), 1);
    found.push({ x, y: Math.floor(n / across), width, height });
    n += width * height;
  }
  return found;
}

/** Uploads texels of four numbers, from one of a texture on, and nothing else of it. */
export function upload(texture: Texture, first: number, texels: Float32Array | Uint16Array | Uint32Array): void {
  const device = texture.device as WebglGraphicsDevice,
    { gl } = device;
  device.setTexture(texture, 0); // which makes one that is not there yet
  device.activeTexture(0);
  device.bindTexture(texture);
  device.setUnpackFlipY(false);
  device.setUnpackPremultiplyAlpha(false);
  device.setUnpackAlignment(1);
  const { _glFormat, _glPixelType } = texture.impl as Format;
  let at = 0;
  for (const { x, y, width, height } of rectangles(first, first + texels.length / 4, texture.width)) {
    const some = texels.subarray(at, (at += 4 * width * height));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, width, height, _glFormat, _glPixelType, some);
  }
}
