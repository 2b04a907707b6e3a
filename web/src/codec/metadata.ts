// Texts about a scene, read as `splatwire.types.metadata` reads them.

/** Largest number of characters of a text; longer ones are cut. */
const MAX_TEXT = 500;
/** Largest size of the section, bytes. */
const MAX_BYTES = 1 << 16;
const SPACES = /[\p{Cc}\p{Zl}\p{Zp}]/gu;
/** Invisible characters, which can reorder or hide others; not the joiners, which scripts and emoji need. */
const INVISIBLE = /(?![\u200c\u200d])[\p{Cf}\p{Cs}\p{Co}\p{Noncharacter_Code_Point}]/gu;
/** Flags with the code of a region in invisible tag characters, which stay. */
const FLAGS = /(\u{1f3f4}[\u{e0030}-\u{e0039}\u{e0061}-\u{e007a}]{3,6}\u{e007f})/u;
/** Part of a flag at the end of a text that was cut, which would be another flag. */
const CUT_FLAG = /\u{1f3f4}[\u{e0030}-\u{e007a}]*$/u;

export interface Texts {
  readonly title: string;
  readonly author: string;
  readonly license: string;
}

/** Returns the texts in the section `metadata`. A text that is missing or damaged is empty. */
export function textsOf(section: Uint8Array | undefined): Texts {
  const content = parsed(section);
  return { title: clean(content["title"]), author: clean(content["author"]), license: clean(content["license"]) };
}

function parsed(section: Uint8Array | undefined): Record<string, unknown> {
  if (!section || section.length > MAX_BYTES) return {};
  try {
    const content: unknown = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(section));
    return typeof content === "object" && content !== null ? (content as Record<string, unknown>) : {};
  } catch {
    return {}; // the texts are not needed to draw the scene
  }
}

/** Returns a text as one line without control characters; empty if the value is no text. */
function clean(value: unknown): string {
  if (typeof value !== "string") return "";
  const parts = value.replace(SPACES, " ").split(FLAGS); // flags are the parts with odd indices
  const visible = parts.map((part, index) => (index % 2 ? part : part.replace(INVISIBLE, ""))).join("");
  const characters = [...visible.split(/\s+/).filter(Boolean).join(" ")],
    text = characters.slice(0, MAX_TEXT).join("");
  return (characters.length > MAX_TEXT ? text.replace(CUT_FLAG, "") : text).trim();
}
