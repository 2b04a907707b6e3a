// JSON subset of manifests: integers of any size, no other numbers, no duplicate keys. Accepts the same texts as the
// Python reader.

import { BitstreamError } from "../bytes.ts";

export type Json = bigint | string | boolean | null | Json[] | Fields;
export type Fields = Map<string, Json>;

const MAX_DEPTH = 100;
const BLANKS = /[ \t\n\r]*/y,
  INTEGER = /-?(?:0|[1-9][0-9]*)(?![.eE])/y,
  LITERAL = /true|false|null/y;
const STRING = /"(?:[^"\\\u0000-\u001f]|\\["\\/bfnrt]|\\u[0-9a-fA-F]{4})*"/y;

/** Parses a text that consists of a single value. Throws `BitstreamError` otherwise. */
export function parseJson(text: string): Json {
  let at = 0;
  const fail = (): never => {
    throw new BitstreamError(`the manifest is not JSON as it should be, at character ${at}`);
  };
  const next = (pattern: RegExp): string | null => {
    pattern.lastIndex = at;
    const found = pattern.exec(text)?.[0] ?? null;
    at += found?.length ?? 0;
    return found;
  };
  const is = (letter: string): boolean => {
    next(BLANKS);
    if (text[at] !== letter) return false;
    at++;
    return true;
  };
  const string = (): string => JSON.parse(next(STRING) ?? fail()) as string;
  const fields = (depth: number): Fields => {
    const found: Fields = new Map();
    if (is("}")) return found;
    do {
      next(BLANKS);
      const key = string();
      if (found.has(key) || !is(":")) fail();
      found.set(key, value(depth));
    } while (is(","));
    return is("}") ? found : fail();
  };
  const list = (depth: number): Json[] => {
    const found: Json[] = [];
    if (is("]")) return found;
    do found.push(value(depth));
    while (is(","));
    return is("]") ? found : fail();
  };
  const value = (depth: number): Json => {
    if (depth > MAX_DEPTH) fail();
    if (is("{")) return fields(depth + 1);
    if (is("[")) return list(depth + 1);
    if (text[at] === '"') return string();
    const integer = next(INTEGER);
    return integer === null ? (JSON.parse(next(LITERAL) ?? fail()) as boolean | null) : BigInt(integer);
  };
  const found = value(0);
  next(BLANKS);
  return at < text.length ? fail() : found;
}

/** Serialises a value as Python does with sorted keys and no spaces. Digests are computed over this text. */
export function writeJson(value: Json): string {
  if (typeof value === "bigint") return value.toString();
  if (Array.isArray(value)) return `[${value.map(writeJson).join(",")}]`;
  if (value instanceof Map)
    return `{${[...value.keys()]
      .sort()
      .map((key) => `${writeJson(key)}:${writeJson(value.get(key)!)}`)
      .join(",")}}`;
  return JSON.stringify(value).replace(
    /[\u007f-\uffff]/g,
    (letter) => `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`,
  );
}
