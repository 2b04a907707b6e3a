// What losses cost: the difference of two pictures, and PSNR.

import type { Show } from "./panel.ts";
import type { Stage } from "./stage.ts";

const STILL_MS = 300;

/** Shows the gains of what is there; once the picture stands still, the difference is drawn over it, and PSNR told. */
export class Comparison {
  /** Lies over the picture. */
  readonly canvas = document.createElement("canvas");
  #gains: Float32Array | null = null;
  #still = 0;
  #comparing = Promise.resolve();

  constructor(
    readonly stage: Stage,
    readonly wanted: () => Show,
    readonly tell: (psnr: string | null) => void,
  ) {
    this.canvas.className = "over";
  }

  show(gains: Float32Array): void {
    this.#gains = gains;
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
    this.stage.draw((view) => void view.setGains(this.wanted() === "lossless" ? null : this.#gains));
  }

  async #compare(): Promise<void> {
    const { view } = this.stage;
    await view?.steady();
    const gains = this.#gains,
      still = this.#still;
    if (!view) return;
    if (gains?.every((gain) => gain === 1)) return this.tell(null);
    await view.setGains(null);
    await view.frame();
    if (still !== this.#still) return this.#apply();
    const lossless = pixelsOf(view.canvas);
    await view.setGains(gains);
    await view.frame();
    if (still !== this.#still) return;
    const psnr = drawDifference(pixelsOf(view.canvas), lossless, this.canvas);
    this.tell(psnr === Infinity ? null : `${psnr.toFixed(1)} dB`);
    this.canvas.classList.toggle("shown", this.wanted() === "difference");
  }
}

/** Error of each pixel, from black (none) to yellow (a tenth of the range or more), drawn on `target`; PSNR in dB. */
function drawDifference(a: ImageData, b: ImageData, target: HTMLCanvasElement): number {
  const out = new ImageData(a.width, a.height);
  let squares = 0;
  for (let i = 0; i < a.data.length; i += 4) {
    let most = 0;
    for (let c = 0; c < 3; c++) {
      const difference = Math.abs(a.data[i + c] - b.data[i + c]);
      squares += difference * difference;
      most = Math.max(most, difference);
    }
    const level = Math.min(most / 25.5, 1);
    out.data[i] = 255 * Math.min(level * 1.5, 1);
    out.data[i + 1] = 255 * level * level;
    out.data[i + 2] = 60 * level * (1 - level);
    out.data[i + 3] = 255;
  }
  target.width = a.width;
  target.height = a.height;
  target.getContext("2d")!.putImageData(out, 0, 0);
  return squares ? 10 * Math.log10((255 ** 2 * 3 * a.width * a.height) / squares) : Infinity;
}

/** A canvas of WebGL, copied in the task in which it was drawn. */
function pixelsOf(canvas: HTMLCanvasElement): ImageData {
  const copy = new OffscreenCanvas(canvas.width, canvas.height),
    context = copy.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(canvas, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
