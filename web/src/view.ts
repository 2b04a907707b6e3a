// The drawing's bundle: most of the page's bytes, loaded while the first of the stream is on its way.

import { View } from "./render/view.ts";

globalThis.splatwireView = View;
