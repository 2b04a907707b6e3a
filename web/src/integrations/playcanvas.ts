// `splatwire/playcanvas`: loads `.swz` streams as PlayCanvas assets of type `gsplat`.

import { type AppBase, type Asset, type GraphicsDevice, GSplatData, GSplatResource } from "playcanvas";

import { decode, type Gaussians, type Options, type ReceivedUpdate, receive } from "../decoder.ts";
import { withoutQuery } from "../transport/http_error.ts";
import { plyColumns } from "./columns.ts";
import { warnOfLosses, warnOfMissing } from "./losses.ts";

export { ClipEntity } from "./playcanvas_clip.ts";

type LoadCallback = (error: string | null, resource?: GSplatResource | null) => void;

/**
 * Parser for `app.loader.getHandler("gsplat").addParser(new SwzParser(app))`. Fires `progress` with packet counts on
 * the asset. Sets `app.scene.gsplat.antiAlias` if a stream requires it.
 */
export class SwzParser {
  constructor(
    readonly app: AppBase,
    /** The default concealer is `grow`. Clips need `frame`. */
    readonly options: Options = {},
  ) {}

  canParse({ ext }: { ext: string }): boolean {
    return ext === "swz";
  }

  load(url: string | { load: string; original: string }, callback: LoadCallback, asset?: Asset): void {
    const address = typeof url === "string" ? url : url.load;
    this.#gaussians(address, asset).then(
      (gaussians) => {
        // never reset, because other streams of the application may require it
        if (gaussians?.antialiased) this.app.scene.gsplat.antiAlias = true;
        callback(null, gaussians && resourceOf(this.app.graphicsDevice, gaussians));
      },
      (error: unknown) => callback(`${address}: ${error instanceof Error ? error.message : error}`),
    );
  }

  /** Resolves to null if the application was destroyed or the asset was unloaded. */
  async #gaussians(url: string, asset?: Asset): Promise<Gaussians | null> {
    const stop = new AbortController(),
      gone = (): boolean => stop.signal.aborted || !(this.app.graphicsDevice as GraphicsDevice | null);
    asset?.once("unload", () => stop.abort());
    const file = (asset?.file as { contents?: BufferSource | Promise<Response | ArrayBuffer> } | null)?.contents,
      options = { ...this.options, concealer: this.options.concealer ?? "grow" };
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
    let last: ReceivedUpdate | null = null;
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
    warnOfMissing(last, withoutQuery(url));
    return last.gaussians;
  }
}

/** Returns Gaussians as a PlayCanvas resource for `gsplat` components. Keeps the axes of the stream. */
export function resourceOf(device: GraphicsDevice, gaussians: Gaussians): GSplatResource {
  const properties = plyColumns(gaussians).map(([name, storage]) => ({ type: "float", name, storage, byteSize: 4 }));
  return new GSplatResource(device, new GSplatData([{ name: "vertex", count: gaussians.count, properties }]));
}
