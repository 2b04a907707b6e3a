// Integer arrays, coded under a normal distribution that the encoder fitted to them.

import { BitstreamError, type ByteReader } from "../bytes.ts";
import { MAX_SYMBOL } from "../codec/network_limits.ts";
import { RangeDecoder } from "./decoder.ts";
import { Mixture } from "./mixture.ts";
import { MEAN_BITS, NUM_SCALES } from "./tables.ts";

export function readIntegers(reader: ByteReader, count: number): Float64Array {
  const mean = reader.signed(),
    scale = reader.unsigned();
  if (Math.abs(mean) > MAX_SYMBOL || scale >= NUM_SCALES)
    throw new BitstreamError(`${reader.subject}: the mean or scale of a distribution is out of range`);
  const coder = new RangeDecoder(reader.blob()),
    normal = new Mixture(mean * 2 ** MEAN_BITS, scale);
  return Float64Array.from({ length: count }, () => normal.decode(coder));
}
