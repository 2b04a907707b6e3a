// node scripts/lines.mjs: names lines over 120 characters, which the formatter leaves where they are text.

import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const WIDTH = 120;
const root = fileURLToPath(new URL("..", import.meta.url));
const files = ["src", "test", "scripts"].flatMap((folder) =>
  readdirSync(join(root, folder), { recursive: true }).map((name) => join(folder, name)),
);
for (const file of files.filter((name) => /\.(ts|mjs)$/.test(name))) {
  const text = readFileSync(join(root, file), "utf8");
  if (text.startsWith("// Made by ")) continue; // by a script in Python
  for (const [n, line] of text.split("\n").entries()) {
    if (line.length <= WIDTH) continue;
    console.log(`${file}:${n + 1}: ${line.length} characters`);
    process.exitCode = 1;
  }
}
