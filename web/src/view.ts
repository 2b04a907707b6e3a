// Entry point of the renderer's bundle: most of the page's bytes, loaded while the first packets are on their way.

import { RENDERER } from "./render/load.ts";
import { View } from "./render/view.ts";

Object.assign(globalThis, { [RENDERER]: View });
