// A graphics device of PlayCanvas in tests.

import { NullGraphicsDevice } from "playcanvas";

/** A device that draws nothing. */
export function deviceOf(): NullGraphicsDevice {
  const device = new NullGraphicsDevice({ width: 1, height: 1, getBoundingClientRect: () => ({}) } as never),
    nothing = (): undefined => undefined;
  return Object.assign(device, {
    isWebGL2: true,
    gl: { texSubImage2D: nothing },
    ...Object.fromEntries(
      ["setTexture", "activeTexture", "bindTexture", "setUnpackFlipY", "setUnpackPremultiplyAlpha"].map((name) => [
        name,
        nothing,
      ]),
    ),
    setUnpackAlignment: nothing,
  });
}
