import assert from "node:assert/strict";
import { test } from "node:test";

import { Vec3 } from "playcanvas";

import { StreamDecoder, type Viewpoint } from "../src/codec/decoder.ts";
import { Controls } from "../src/render/controls.ts";
import { Orbit } from "../src/render/orbit.ts";
import { readStream, STREAMS } from "./vectors.ts";

const section = (numbers: number[]): Uint8Array => new Uint8Array(new Float32Array(numbers).buffer);

function viewpointOf(bytes: Uint8Array | null): Viewpoint | null {
  const decoder = new StreamDecoder(readStream(STREAMS[0]).head);
  if (bytes) decoder.elementDecoder.sections.set("viewpoint", bytes);
  else decoder.elementDecoder.sections.delete("viewpoint");
  return decoder.viewpoint;
}

const orbitOf = (): Orbit => new Orbit(() => undefined);

test("a viewpoint is read exactly, and rejected if invalid", {
  skip: STREAMS.length === 0,
}, () => {
  assert.equal(viewpointOf(null), null);
  assert.deepEqual(viewpointOf(section([1, 2, 3, 4, 5, 6, 0, -1, 0])), {
    eye: [1, 2, 3],
    target: [4, 5, 6],
    up: [0, -1, 0],
  });
  for (const numbers of [
    [1, 2, 3, 1, 2, 3, 0, 1, 0],
    [1, 2, 3, 4, 5, 6, 0, 0, 0],
    [NaN, 2, 3, 4, 5, 6, 0, 1, 0],
    [Infinity, 2, 3, 4, 5, 6, 0, 1, 0],
    [1, 2, 3],
  ]) {
    assert.throws(() => viewpointOf(section(numbers)), /section|viewpoint/);
  }
});

test("the origin of a georeferenced scene is read in float64, and rejected if invalid", {
  skip: STREAMS.length === 0,
}, () => {
  const originOf = (numbers: number[] | null): [number, number, number] => {
    const decoder = new StreamDecoder(readStream(STREAMS[0]).head);
    if (numbers) decoder.elementDecoder.sections.set("origin", new Uint8Array(new Float64Array(numbers).buffer));
    return decoder.origin;
  };
  assert.deepEqual(originOf(null), [0, 0, 0]);
  assert.deepEqual(originOf([451234.5, 5411876.25, -118]), [451234.5, 5411876.25, -118]);
  for (const numbers of [
    [1, 2],
    [1, 2, 3, 4],
    [NaN, 0, 0],
    [0, Infinity, 0],
    [0, 0, 2e12],
  ])
    assert.throws(() => originOf(numbers), /section|origin/);
});

test("a scene turned upside down stays so when the stream's viewpoint is set", () => {
  for (const first of ["turn", "place"]) {
    const orbit = orbitOf(),
      up = new Vec3(0, -1, 0);
    if (first === "turn") orbit.flip();
    orbit.place(new Vec3(2, 0.5, -1), new Vec3(), up);
    if (first === "place") orbit.flip();
    assert.ok(
      orbit
        .pose()
        .rotation.transformVector(new Vec3(0, 1, 0), new Vec3())
        .dot(up) < 0,
    );
    orbit.flip();
    assert.ok(orbit.pose().position.distance(new Vec3(2, 0.5, -1)) < 1e-5);
  }
});

test("dragging to the right moves the scene to the right for any up axis", () => {
  for (const prepare of [() => undefined, (orbit: Orbit) => orbit.setUp("y"), (orbit: Orbit) => orbit.flip()]) {
    const events = new Map<string, (event: unknown) => void>(),
      surface = {
        clientHeight: 600,
        addEventListener: (kind: string, take: (event: unknown) => void) => events.set(kind, take),
        setPointerCapture: () => undefined,
      },
      { orbit } = new Controls(surface as unknown as HTMLElement, orbitOf());
    prepare(orbit);
    const { position, rotation } = orbit.pose(),
      near = position.clone().lerp(position, orbit.target, 0.9);
    const aside = (point: Vec3): number => {
      const pose = orbit.pose();
      return pose.rotation.transformVector(Vec3.RIGHT, new Vec3()).dot(new Vec3().sub2(point, pose.position));
    };
    assert.ok(Math.abs(aside(near)) < 1e-6, `${rotation}`);
    events.get("pointerdown")!({ target: {}, pointerId: 1, offsetX: 50, offsetY: 50 });
    events.get("pointermove")!({ target: {}, pointerId: 1, offsetX: 80, offsetY: 50, buttons: 1 });
    assert.ok(aside(near) > 1e-3);
  }
});

test("an orbit starts at its position, looks at the target and respects the up vector", () => {
  const orbit = orbitOf();
  for (const up of [new Vec3(0, 1, 0), new Vec3(0, -1, 0), new Vec3(0.3, -0.9, 0.2).normalize(), new Vec3(1, 0, 0)]) {
    const eye = new Vec3(2, 0.5, -1),
      target = new Vec3(0.1, 0.2, 0.3);
    orbit.place(eye, target, up);
    const { position, rotation } = orbit.pose();
    assert.ok(position.distance(eye) < 1e-5, `${up} ${position}`);
    const ahead = rotation.transformVector(new Vec3(0, 0, -1), new Vec3());
    assert.ok(ahead.distance(new Vec3().sub2(target, eye).normalize()) < 1e-5);
    assert.ok(rotation.transformVector(new Vec3(0, 1, 0), new Vec3()).dot(up) > 0);
  }
});
