// Named sections after the fixed part of the side information.

import { BitstreamError, ByteReader } from "../bytes.ts";
import { MAX_SECTION_BYTES, MAX_SECTION_NAME, MAX_SECTIONS, RESERVED_SECTIONS } from "./limits.ts";

const NAME = new RegExp(`^[a-z][a-z0-9_]{0,${MAX_SECTION_NAME - 1}}$`);

/** Returns the sections' contents by name, including unknown sections. */
export function readSections(bytes: Uint8Array): Map<string, Uint8Array> {
  const reader = new ByteReader(bytes, "side information sections"),
    sections = new Map<string, Uint8Array>();
  let last = "";
  while (reader.left) {
    const name = String.fromCharCode(...reader.take(Math.min(reader.unsigned(), MAX_SECTION_NAME + 1)));
    if (!NAME.test(name) || name <= last || RESERVED_SECTIONS.includes(name))
      throw new BitstreamError("side information: a section's name is invalid, reserved, repeated or out of order");
    const content = reader.blob();
    sections.set(name, content);
    last = name;
    if (sections.size > MAX_SECTIONS || content.length > MAX_SECTION_BYTES)
      throw new BitstreamError("side information: too many or too large sections");
  }
  return sections;
}
