// The difference of two pictures, and PSNR.

/** Error of each pixel, from black (none) to yellow (a tenth of the range or more), drawn on `target`; PSNR in dB. */
export function drawDifference(a: ImageData, b: ImageData, target: HTMLCanvasElement): number {
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
export function pixelsOf(canvas: HTMLCanvasElement): ImageData {
  const copy = new OffscreenCanvas(canvas.width, canvas.height), context = copy.getContext("2d", { willReadFrequently: true })!;
  context.drawImage(canvas, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
