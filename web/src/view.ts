// Entry point of the renderer's bundle: most of the page's bytes, loaded while the first packets are on their way.

import { View } from "./render/view.ts";

globalThis.splatwireView = View;
