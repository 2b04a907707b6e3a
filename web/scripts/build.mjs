// node scripts/build.mjs FILE: writes the bundle.

import { writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

import { bundle } from "./bundle.mjs";

const text = await bundle();
writeFileSync(process.argv[2], text);
console.log(`${process.argv[2]}: ${Buffer.byteLength(text).toLocaleString()} bytes, ${gzipSync(text, { level: 9 }).length.toLocaleString()} compressed`);
