import assert from "node:assert/strict";
import { test } from "node:test";

import { Vec3 } from "playcanvas";

import { StreamDecoder, type Viewpoint } from "../src/codec/decoder.ts";
import { Orbit } from "../src/render/orbit.ts";
import { readStream, STREAMS } from "./vectors.ts";

const section = (numbers: number[]): Uint8Array => new Uint8Array(new Float32Array(numbers).buffer);

function viewpointOf(bytes: Uint8Array | null): Viewpoint | null {
  const decoder = new StreamDecoder(readStream(STREAMS[0]).head);
  if (bytes) decoder.info.sections.set("viewpoint", bytes);
  else decoder.info.sections.delete("viewpoint");
  return decoder.viewpoint;
}

test("a viewpoint is read as it was written, and believed only where it is possible", { skip: STREAMS.length === 0 }, () => {
  assert.equal(viewpointOf(null), null);
  assert.deepEqual(viewpointOf(section([1, 2, 3, 4, 5, 6, 0, -1, 0])), { eye: [1, 2, 3], target: [4, 5, 6], up: [0, -1, 0] });
  for (const numbers of [[1, 2, 3, 1, 2, 3, 0, 1, 0], [1, 2, 3, 4, 5, 6, 0, 0, 0], [NaN, 2, 3, 4, 5, 6, 0, 1, 0], [Infinity, 2, 3, 4, 5, 6, 0, 1, 0], [1, 2, 3]]) {
    assert.throws(() => viewpointOf(section(numbers)), /section|viewpoint/);
  }
});

test("an orbit begins where it was placed, looks at the target and has up on its side", () => {
  const orbit = new Orbit({ addEventListener: () => undefined } as unknown as HTMLElement, () => undefined);
  for (const up of [new Vec3(0, 1, 0), new Vec3(0, -1, 0), new Vec3(0.3, -0.9, 0.2).normalize(), new Vec3(1, 0, 0)]) {
    const eye = new Vec3(2, 0.5, -1), target = new Vec3(0.1, 0.2, 0.3);
    orbit.place(eye, target, up);
    const { position, rotation } = orbit.pose();
    assert.ok(position.distance(eye) < 1e-5, `${up} ${position}`);
    const ahead = rotation.transformVector(new Vec3(0, 0, -1), new Vec3());
    assert.ok(ahead.distance(new Vec3().sub2(target, eye).normalize()) < 1e-5);
    assert.ok(rotation.transformVector(new Vec3(0, 1, 0), new Vec3()).dot(up) > 0);
  }
});
