// Entry point of the renderer's bundle: most of the page's bytes, loaded while the first packets are on their way.

import { RENDERER } from "./render/load.ts";
import { WebGLRenderer } from "./render/webgl_renderer.ts";

Object.assign(globalThis, { [RENDERER]: WebGLRenderer });
