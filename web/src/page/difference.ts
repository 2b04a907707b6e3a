// What losses cost: the difference of two pictures, and PSNR.

import { type Pause, pausing } from "../turns.ts";
import type { Show } from "./panel.ts";
import type { Stage } from "./stage.ts";

const STILL_MS = 300;

/** Shows the gains of what is there; once the picture stands still, the difference is drawn over it, and PSNR told. */
export class Comparison {
  /** Lies over the picture. */
  readonly canvas = document.createElement("canvas");
  #gains: Float32Array | null = null;
  /** Gains of the picture to compare with; null draws every Gaussian as it is. */
  #lossless: Float32Array | null = null;
  #still = 0;
  #comparing = Promise.resolve();

  constructor(
    readonly stage: Stage,
    readonly wanted: () => Show,
    readonly tell: (psnr: string | null) => void,
  ) {
    this.canvas.className = "over";
  }

  /** `lossless`: gains of the picture to compare with, which has no redundant Gaussians. */
  show(gains: Float32Array, lossless: Float32Array | null): void {
    this.#gains = gains;
    this.#lossless = lossless;
    this.#apply();
    this.moved();
  }

  /** Compares no more. */
  destroy(): void {
    clearTimeout(this.#still);
  }

  /** Hears that the picture changed. */
  moved(): void {
    clearTimeout(this.#still);
    this.canvas.classList.remove("shown");
    if (this.wanted() === "lossless" || !this.#gains) return;
    this.#still = window.setTimeout(() => this.alone(() => this.#compare()).catch(() => undefined), STILL_MS);
  }

  /** Does something while no comparison changes what is drawn. */
  alone<T>(work: () => Promise<T>): Promise<T> {
    const done = this.#comparing.then(work);
    this.#comparing = done.then(
      () => undefined,
      () => undefined,
    );
    return done;
  }

  #apply(): void {
    this.stage.draw((view) => void view.setGains(this.wanted() === "lossless" ? this.#lossless : this.#gains));
  }

  async #compare(): Promise<void> {
    const { view } = this.stage;
    await view?.steady();
    const gains = this.#gains,
      lossless = this.#lossless,
      still = this.#still;
    if (!view) return;
    if (gains?.every((gain, n) => gain === (lossless?.[n] ?? 1))) return this.tell(null);
    await view.setGains(lossless);
    await view.frame();
    if (still !== this.#still) return this.#apply();
    const reference = pixelsOf(view.canvas);
    await view.setGains(gains);
    await view.frame();
    const pause = pausing(() => still === this.#still),
      difference = await differenceOf(pixelsOf(view.canvas), reference, pause);
    if (!difference) return;
    const { picture, psnr } = difference;
    this.canvas.width = picture.width;
    this.canvas.height = picture.height;
    this.canvas.getContext("2d")!.putImageData(picture, 0, 0);
    this.tell(psnr === Infinity ? null : `${psnr.toFixed(1)} dB`);
    this.canvas.classList.toggle("shown", this.wanted() === "difference");
  }
}

/**
 * Error of each pixel, from black (none) to yellow (a tenth of the range or more); PSNR in dB. Null where nobody waits
 * for it any more.
 */
async function differenceOf(
  a: ImageData,
  b: ImageData,
  pause: Pause,
): Promise<{ readonly picture: ImageData; readonly psnr: number } | null> {
  const { width, height } = a,
    picture = new ImageData(width, height),
    [x, y, out] = [a.data, b.data, picture.data]; // each look at `data` calls the browser
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

/** A canvas of WebGL, copied in the task in which it was drawn. */
function pixelsOf(canvas: HTMLCanvasElement): ImageData {
  const copy = new OffscreenCanvas(canvas.width, canvas.height),
    context = copy.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(canvas, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
