// `splatwire/playcanvas`: assets of the type `gsplat` out of `.swz` streams, in applications of PlayCanvas.

import { type AppBase, type Asset, type GraphicsDevice, GSplatData, GSplatResource } from "playcanvas";

import { type Arrived, decode, type Gaussians, type Options, receive } from "../decoder.ts";
import { plyColumns } from "./columns.ts";
import { warnOfLosses } from "./losses.ts";

type Told = (error: string | null, resource?: GSplatResource | null) => void;

/**
 * For `app.loader.getHandler("gsplat").addParser(new SwzParser(app))`. Fires `progress` with packets at the asset, and
 * sets `app.scene.gsplat.antiAlias` where a stream asks for it.
 */
export class SwzParser {
  constructor(
    readonly app: AppBase,
    /** The concealer is `grow` by default; clips need `frame`. */
    readonly options: Options = {},
  ) {}

  canParse({ ext }: { ext: string }): boolean {
    return ext === "swz";
  }

  load(url: string | { load: string; original: string }, callback: Told, asset?: Asset): void {
    const address = typeof url === "string" ? url : url.load;
    this.#gaussians(address, asset).then(
      (gaussians) => {
        // of the whole application there: never taken back, for what else is there may want it
        if (gaussians?.antialiased) this.app.scene.gsplat.antiAlias = true;
        callback(null, gaussians && resourceOf(this.app.graphicsDevice, gaussians));
      },
      (error: unknown) => callback(`${address}: ${error instanceof Error ? error.message : error}`),
    );
  }

  /** Null where the application is gone by then, or the asset is not wanted any more. */
  async #gaussians(url: string, asset?: Asset): Promise<Gaussians | null> {
    const stop = new AbortController(),
      gone = (): boolean => stop.signal.aborted || !(this.app.graphicsDevice as GraphicsDevice | null);
    asset?.once("unload", () => stop.abort());
    const file = (asset?.file as { contents?: BufferSource | Promise<Response | ArrayBuffer> } | null)?.contents,
      options = { concealer: "grow", ...this.options };
    if (file) {
      const there = await file,
        bytes = there instanceof Response ? await there.arrayBuffer() : there;
      const view = ArrayBuffer.isView(bytes)
        ? new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength)
        : new Uint8Array(bytes);
      const scene = await decode(view, options);
      if (gone()) return null;
      warnOfLosses(scene, url);
      return scene.gaussians;
    }
    let last: Arrived | null = null;
    try {
      for await (const arrived of receive(url, { ...options, signal: stop.signal })) {
        last = arrived;
        asset?.fire("progress", arrived.packets, arrived.expected);
      }
    } catch (error) {
      if (!stop.signal.aborted) throw error;
    }
    if (gone()) return null;
    if (!last) throw new Error("nothing arrived");
    return last.gaussians;
  }
}

/** Gaussians as a resource of PlayCanvas, for components `gsplat`. Axes stay those of the stream. */
export function resourceOf(device: GraphicsDevice, gaussians: Gaussians): GSplatResource {
  const properties = plyColumns(gaussians).map(([name, storage]) => ({ type: "float", name, storage, byteSize: 4 }));
  return new GSplatResource(device, new GSplatData([{ name: "vertex", count: gaussians.count, properties }]));
}
