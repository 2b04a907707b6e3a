// node scripts/build.mjs FOLDER: writes the bundles.

import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

import { bundles } from "./bundle.mjs";

for (const [name, text] of await bundles()) {
  writeFileSync(join(process.argv[2], name), text);
  const compressed = gzipSync(text, { level: 9 }).length;
  console.log(`${name}: ${Buffer.byteLength(text).toLocaleString()} bytes, ${compressed.toLocaleString()} compressed`);
}
