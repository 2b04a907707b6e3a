// Comparison of the picture with and without losses: difference image and PSNR.

import { type Pause, periodicPause } from "../scheduler.ts";
import { createElement } from "./elements.ts";
import type { PictureMode } from "./panel.ts";
import type { Stage } from "./stage.ts";

const REST_MS = 300;

/** Reported while the PSNR of the current picture is unknown, and while the picture without losses is shown. */
const PENDING = "comparing ...",
  NOT_COMPARED = "not compared";

/**
 * Applies concealment gains. Once the picture does not change any more, draws the difference over it and reports the
 * PSNR.
 */
export class Comparison {
  /** Overlay for the difference image. */
  readonly canvas = createElement("canvas", { class: "over" });
  #gains: Float32Array | null = null;
  /** Gains of the reference picture; null draws every Gaussian unchanged. */
  #lossless: Float32Array | null = null;
  /** True if the two pictures may differ, and no other gains are awaited. */
  #differs = false;
  #timer = 0;
  /** Number of changes of the picture so far. A comparison ends when it changes. */
  #changes = 0;
  #running = Promise.resolve();

  constructor(
    readonly stage: Stage,
    readonly mode: () => PictureMode,
    readonly report: (psnr: string | null) => void,
  ) {}

  /** Applies gains; null for 1. `lossless` are the gains of the reference picture, which hides redundant Gaussians. */
  show(gains: Float32Array | null, lossless: Float32Array | null): void {
    const isChanged = gains !== null || this.#gains !== null;
    this.#gains = gains;
    this.#lossless = lossless;
    this.#differs = gains?.some((gain, n) => gain !== (lossless?.[n] ?? 1)) ?? false;
    if (isChanged) this.#apply();
    if (!this.#differs) this.report(null);
    this.pictureChanged();
  }

  /** Announces other gains, which are still computed. Until then nothing is compared. */
  awaitGains(): void {
    this.#differs = false;
    this.#changes++;
    clearTimeout(this.#timer);
    this.report(PENDING);
  }

  /** Stops comparing. */
  destroy(): void {
    this.#changes++;
    clearTimeout(this.#timer);
  }

  /** Restarts the comparison because the picture changed. */
  pictureChanged(): void {
    const change = ++this.#changes;
    clearTimeout(this.#timer);
    this.canvas.classList.remove("shown");
    if (!this.#differs) return;
    if (this.mode() === "lossless") return this.report(NOT_COMPARED);
    this.report(PENDING);
    this.#timer = window.setTimeout(
      () => this.withoutComparison(() => this.#compare(() => change === this.#changes)).catch(() => undefined),
      REST_MS,
    );
  }

  /** Runs a task while no comparison changes the picture. */
  withoutComparison<T>(work: () => Promise<T>): Promise<T> {
    const done = this.#running.then(work);
    this.#running = done.then(
      () => undefined,
      () => undefined,
    );
    return done;
  }

  #apply(): void {
    this.stage.withRenderer(
      (renderer) => void renderer.setGains(this.mode() === "lossless" ? this.#lossless : this.#gains),
    );
  }

  /** Compares the pictures with both gains. `isCurrent` returns false once the picture has changed. */
  async #compare(isCurrent: () => boolean): Promise<void> {
    const { renderer } = this.stage;
    await renderer?.replacementSorted();
    const gains = this.#gains,
      lossless = this.#lossless;
    if (!renderer || !isCurrent()) return;
    await renderer.setGains(lossless);
    await renderer.frame();
    if (!isCurrent()) return this.#apply();
    const reference = pixelsOf(renderer.canvas);
    await renderer.setGains(gains);
    await renderer.frame();
    if (!isCurrent()) return this.#apply();
    const difference = await differenceOf(pixelsOf(renderer.canvas), reference, periodicPause(isCurrent));
    if (!difference) return;
    const { picture, psnr } = difference;
    this.canvas.width = picture.width;
    this.canvas.height = picture.height;
    this.canvas.getContext("2d")!.putImageData(picture, 0, 0);
    this.report(psnr === Infinity ? null : `${psnr.toFixed(1)} dB`);
    this.canvas.classList.toggle("shown", this.mode() === "difference");
  }
}

/**
 * Computes the error of each pixel, from black (none) to yellow (at least a tenth of the range), and the PSNR in dB.
 * Resolves to null if the result is no longer needed.
 */
async function differenceOf(
  a: ImageData,
  b: ImageData,
  pause: Pause,
): Promise<{ readonly picture: ImageData; readonly psnr: number } | null> {
  const { width, height } = a,
    picture = new ImageData(width, height),
    [x, y, out] = [a.data, b.data, picture.data]; // each access to `data` calls into the browser
  let squares = 0;
  for (let row = 0; row < height; row++) {
    if (!(await pause())) return null;
    for (let i = 4 * width * row; i < 4 * width * (row + 1); i += 4) {
      const red = Math.abs(x[i] - y[i]),
        green = Math.abs(x[i + 1] - y[i + 1]),
        blue = Math.abs(x[i + 2] - y[i + 2]),
        level = Math.min(Math.max(red, green, blue) / 25.5, 1);
      squares += red * red + green * green + blue * blue;
      out[i] = 255 * Math.min(level * 1.5, 1);
      out[i + 1] = 255 * level * level;
      out[i + 2] = 60 * level * (1 - level);
      out[i + 3] = 255;
    }
  }
  return { picture, psnr: squares ? 10 * Math.log10((255 ** 2 * 3 * width * height) / squares) : Infinity };
}

/** Copies a WebGL canvas. Works only in the task of its last frame. */
function pixelsOf(canvas: HTMLCanvasElement): ImageData {
  const copy = new OffscreenCanvas(canvas.width, canvas.height),
    context = copy.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(canvas, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
