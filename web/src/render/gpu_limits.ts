// GPU backpressure: uploads wait until the GPU has finished earlier work, so that the page stays responsive.

import type { Texture, WebglGraphicsDevice } from "playcanvas";

import { delay, nextTask, SLICE_MS } from "../scheduler.ts";

/** Upload budget before waiting for the GPU, bytes, and polling interval, milliseconds. */
const UPLOAD_BUDGET = 1 << 22,
  POLL_MS = 4;

interface Format {
  readonly _glFormat: number;
  readonly _glPixelType: number;
}

export class GpuFence {
  #fence: WebGLSync | null = null;
  #markedAt = 0;
  /** Time until the GPU passed the last fence, milliseconds. It is measured when `idle` is read. */
  busyMs = 0;

  constructor(readonly device: WebglGraphicsDevice) {}

  /** Inserts a fence after all commands so far. */
  mark(): void {
    const { gl } = this.device;
    gl.deleteSync(this.#fence);
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.#markedAt = performance.now();
  }

  /** True if the GPU has passed the fence. A lost context counts as idle. */
  get idle(): boolean {
    const { gl } = this.device;
    if (this.#fence && gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) === gl.UNSIGNALED) return false;
    if (this.#fence) this.busyMs = performance.now() - this.#markedAt;
    gl.deleteSync(this.#fence);
    this.#fence = null;
    return true;
  }

  /** Resolves once the GPU is idle or `stopped` returns true. */
  async wait(stopped: () => boolean): Promise<void> {
    while (!stopped() && !this.idle) await delay(POLL_MS);
  }
}

/** Divides uploads into slices: yields to other tasks, and waits for the GPU after much data. */
export class UploadSlices {
  /** Bytes uploaded since the last wait for the GPU, and the time of the last yield. */
  #bytes = 0;
  #yieldedAt = performance.now();

  constructor(
    readonly gpu: GpuFence,
    readonly stopped: () => boolean,
  ) {}

  /** Starts a new slice. */
  begin(): void {
    this.#yieldedAt = performance.now();
  }

  /** Ends a part of the upload of `bytes` bytes. Resolves when the next part may begin. */
  async after(bytes: number): Promise<void> {
    this.#bytes += bytes;
    const much = this.#bytes > UPLOAD_BUDGET;
    if (!much && performance.now() - this.#yieldedAt < SLICE_MS) return;
    if (much) {
      this.gpu.mark();
      this.#bytes = 0;
    }
    await nextTask();
    if (much) await this.gpu.wait(this.stopped);
    this.#yieldedAt = performance.now();
  }
}

/** Rectangle of texels. */
export interface Rectangle {
  readonly x: number;
  readonly y: number;
  readonly width: number;
  readonly height: number;
}

/**
 * Returns the rectangles that cover texels `first` to `end - 1`: the rest of a row, whole rows, the start of the last
 * row.
 */
export function texelRectangles(first: number, end: number, across: number): Rectangle[] {
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

/** Uploads texels of four numbers, from index `first`. Other texels keep their values. */
export function uploadTexels(texture: Texture, first: number, texels: Float32Array | Uint16Array | Uint32Array): void {
  const device = texture.device as WebglGraphicsDevice,
    { gl } = device;
  device.setTexture(texture, 0); // creates the texture if needed
  device.activeTexture(0);
  device.bindTexture(texture);
  device.setUnpackFlipY(false);
  device.setUnpackPremultiplyAlpha(false);
  device.setUnpackAlignment(1);
  const { _glFormat, _glPixelType } = texture.impl as Format;
  let at = 0;
  for (const { x, y, width, height } of texelRectangles(first, first + texels.length / 4, texture.width)) {
    const some = texels.subarray(at, (at += 4 * width * height));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, width, height, _glFormat, _glPixelType, some);
  }
}
