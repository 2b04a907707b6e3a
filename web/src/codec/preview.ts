// Previews: at most 133 Gaussians in one datagram, shown until the scene arrives.

import { BitstreamError, ByteReader } from "../bytes.ts";
import { emptySplats, type Splats } from "./splats.ts";

const VERSION = 1,
  BITS = [8, 8, 8, 5, 5, 5, 5, 5, 5, 4],
  MAX_BYTES = 1024;

export interface Preview {
  readonly splats: Splats;
  readonly background: readonly [number, number, number];
  /** Size of the scene's main part, world units. */
  readonly spread: number;
}

export function readPreview(bytes: Uint8Array): Preview {
  const reader = new ByteReader(bytes, "preview");
  if (bytes.length > MAX_BYTES || reader.u8() !== VERSION)
    throw new BitstreamError("preview: too large, or of another version");
  const count = reader.u8(),
    background: [number, number, number] = [reader.u8() / 255, reader.u8() / 255, reader.u8() / 255];
  const [x, y, z, spread, ...bounds] = Array.from({ length: 12 }, () => reader.f32());
  const low = bounds.slice(0, 4),
    high = bounds.slice(4),
    middle = [x, y, z];
  const body = reader.take(Math.ceil((count * 58) / 8));
  reader.finish();
  const fine =
    count >= 1 &&
    middle.every((value) => Math.abs(value) <= 2 ** 20) &&
    spread >= 2 ** -20 &&
    spread <= 2 ** 20 &&
    low.every((value, n) => value <= high[n] && value >= (n < 3 ? -8 : -12) && high[n] <= (n < 3 ? 8 : 6));
  if (!fine) throw new BitstreamError("preview: a number is out of range");
  const splats = emptySplats(count, 0);
  let bit = 0;
  const number = (bits: number): number => {
    let value = 0;
    for (const end = bit + bits; bit < end; bit++) value = 2 * value + ((body[bit >> 3] >> (7 - (bit & 7))) & 1);
    return value / (2 ** bits - 1);
  };
  for (let i = 0; i < count; i++) {
    const [px, py, pz, sx, sy, sz, red, green, blue, opacity] = BITS.map(number);
    [px, py, pz].forEach(
      (p, a) => (splats.means[3 * i + a] = middle[a] + spread * Math.sinh(low[a] + p * (high[a] - low[a]))),
    );
    [sx, sy, sz].forEach((s, a) => (splats.scales[3 * i + a] = spread * Math.exp(low[3] + s * (high[3] - low[3]))));
    splats.colours.set([red, green, blue], 3 * i);
    splats.quats[4 * i] = 1;
    splats.opacities[i] = 1 / 32 + (opacity * 30) / 32;
  }
  return { splats, background, spread };
}
