// Pictures of a scene that the server draws, because browsers do not: one at a time, small ones while something moves.

import type { Orbit } from "../render/orbit.ts";
import { FIELD_OF_VIEW } from "../render/orbit.ts";
import type { Panel, Settings } from "./panel.ts";

const STILL_MS = 250, POLL_MS = 500, TARGET_MS = 120, LOWEST = 96, HIGHEST = 540, SHARPEST = 1080;

/** What the server says of a picture. */
export interface PictureStatus {
  readonly bytes: number;
  readonly packets: number;
  readonly expected: number;
  readonly known: number;
  readonly total: number;
  readonly seconds: number;
  readonly psnr: number | string | null;
  readonly ms: number;
  readonly note: string;
  /** Whether more may come by itself. */
  readonly pending: boolean;
}

export class Pictures {
  #changedAt = 0;
  #drawnAt = -1;
  #height = 180;
  #sharp = true;
  #going: Promise<void> | null = null;

  /** `told` is called with every picture's status, `failed` with why there is none. */
  constructor(
    readonly url: string, readonly canvas: HTMLCanvasElement, readonly orbit: Orbit, readonly settings: () => Settings,
    readonly told: (status: PictureStatus, sharp: boolean) => void, readonly failed: (text: string) => void,
  ) {
    canvas.classList.add("shown");
  }

  /** Hears that another picture is wanted. */
  change(): void {
    this.#changedAt = performance.now();
    this.#sharp = false;
    this.#going ??= this.#draw().catch((error: unknown) => this.failed((error as Error).message)).finally(() => (this.#going = null));
  }

  async #draw(): Promise<void> {
    while (!this.#sharp) {
      const at = this.#changedAt, rest = STILL_MS - (performance.now() - at);
      if (this.#drawnAt !== at) {
        const began = performance.now();
        await this.#picture(this.#height, false);
        const factor = Math.sqrt(Math.min(Math.max(TARGET_MS / (performance.now() - began), 0.5), 1.5));
        this.#height = Math.min(Math.max(Math.round(this.#height * factor), LOWEST), HIGHEST);
        this.#drawnAt = at;
      } else if (rest > 0) await new Promise((resolve) => setTimeout(resolve, rest));
      else {
        this.#sharp = true;
        await this.#picture(Math.min(this.canvas.clientHeight * Math.min(devicePixelRatio, 2), SHARPEST), true);
      }
    }
  }

  async #picture(height: number, sharp: boolean): Promise<void> {
    const { position, rotation: { x, y, z, w } } = this.orbit.pose(), { concealer, dropped, burst, seed, sent, show } = this.settings();
    const width = Math.max(Math.round((height * this.canvas.clientWidth) / Math.max(this.canvas.clientHeight, 1)), 1);
    // PlayCanvas's camera looks along -z with y up; turned half around x it is OpenCV's.
    const numbers = {
      x: position.x, y: position.y, z: position.z, a: -x, b: w, c: z, d: -y, fov: (FIELD_OF_VIEW * Math.PI) / 180, width, height: Math.max(Math.round(height), 1),
      drop: dropped, burst, seed, sent, score: sharp ? 1 : 0,
    };
    const query = new URLSearchParams(Object.entries(numbers).map(([name, value]) => [name, String(value)]));
    query.append("concealer", concealer);
    query.append("show", show);
    const answer = await fetch(`${this.url}?${query}`, { headers: { "splatwire-page": "1" } });
    if (!answer.ok) throw new Error(await answer.text());
    const status = JSON.parse(answer.headers.get("splatwire-picture") ?? "{}") as PictureStatus, bitmap = await createImageBitmap(await answer.blob());
    this.canvas.width = bitmap.width;
    this.canvas.height = bitmap.height;
    this.canvas.getContext("2d")!.drawImage(bitmap, 0, 0);
    bitmap.close();
    this.told(status, sharp);
    if (sharp && status.pending) setTimeout(() => this.change(), POLL_MS);
  }
}

/** What a picture's status says, on the panel. */
export function tellPicture(panel: Panel, status: PictureStatus, sharp: boolean): void {
  const { packets, expected, known, total, bytes, psnr } = status;
  panel.progress(expected ? packets / expected : 0);
  panel.tell("packets", `${packets.toLocaleString()} of ${expected.toLocaleString()}`);
  panel.tell("elements", total ? `${known.toLocaleString()} of ${total.toLocaleString()}` : "-");
  panel.tell("received", `${(bytes / 1e6).toFixed(2)} MB`);
  panel.tell("drawing", `${status.ms.toFixed(0)} ms, by the server`);
  if (sharp) panel.tell("PSNR", typeof psnr === "number" ? `${psnr.toFixed(2)} dB` : (psnr ?? "-"));
  panel.say(status.note || "Drawn by the server.");
}
