import assert from "node:assert/strict";
import { test } from "node:test";

import { Vec3 } from "playcanvas";

import type { Splats } from "../src/codec/splats.ts";
import { coreOf, frameScene } from "../src/render/framing.ts";
import { cameraOf, Orbit, tangentOf } from "../src/render/orbit.ts";
import { type Packed, pack } from "../src/render/packed.ts";
import { depthAt } from "../src/render/pick.ts";
import { Space } from "../src/render/space.ts";
import { random } from "./vectors.ts";

const WINDOWS = [
  [1280, 760],
  [390, 790],
  [600, 100],
] as const;

/** Round opaque Gaussians at points. */
function scene(points: readonly (readonly number[])[], size: number): Packed {
  const count = points.length;
  const splats: Splats = {
    count,
    degree: 0,
    means: Float32Array.from(points.flat()),
    scales: new Float32Array(3 * count).fill(size),
    quats: Float32Array.from({ length: 4 * count }, (_, n) => (n % 4 ? 0 : 1)),
    opacities: new Float32Array(count).fill(0.9),
    colours: new Float32Array(3 * count).fill(0.5),
    harmonics: new Float32Array(0),
  } as unknown as Splats;
  return pack([splats], 0, 1);
}

const draw = random(7),
  normal = (): number => Math.sqrt(-2 * Math.log(1 - draw())) * Math.cos(2 * Math.PI * draw());

/** Points on a sphere. */
function sphere(count: number, radius: number, stretch: readonly number[] = [1, 1, 1]): number[][] {
  return Array.from({ length: count }, () => {
    const point = [normal(), normal(), normal()],
      length = Math.hypot(...point);
    return point.map((value, a) => (radius * stretch[a] * value) / length);
  });
}

/** Points on the walls of a box, two of them farther away. */
function walls(count: number, half: number): number[][] {
  return Array.from({ length: count }, (_, n) => {
    const point = [0, 1, 2].map(() => half * (2 * draw() - 1));
    point[n % 3] = n % 2 ? half : -half;
    return point;
  });
}

interface Hands {
  orbit: Orbit;
  act(kind: string, event: object): void;
}

function hands(parts: readonly Packed[]): Hands {
  const events = new Map<string, (event: unknown) => void>(),
    canvas = {
      clientHeight: 600,
      addEventListener: (kind: string, take: (event: unknown) => void) => events.set(kind, take),
      setPointerCapture: () => undefined,
    },
    space = new Space(coreOf(parts), parts);
  const orbit = new Orbit(
    canvas as unknown as HTMLElement,
    () => undefined,
    () => space,
  );
  return { orbit, act: (kind, event) => events.get(kind)!({ preventDefault: () => undefined, ...event }) };
}

function framed(orbit: Orbit, parts: readonly Packed[], width: number, height: number): void {
  const core = coreOf(parts),
    down = tangentOf(width, height);
  frameScene(orbit, core, new Space(core, parts), (down * width) / height, down);
}

test("a scene fits a window whatever its aspect, and fills it one way", () => {
  for (const stretch of [
    [1, 3, 1],
    [3, 1, 1],
    [1, 1, 1],
  ]) {
    const far = [40, 40, 40], // one that is no part of the scene
      parts = [scene([...sphere(3000, 1, stretch), far], 0.05)];
    for (const [width, height] of WINDOWS) {
      const { orbit } = hands(parts);
      framed(orbit, parts, width, height);
      const { viewmat, focal } = cameraOf(orbit.pose(), 1, width, height),
        [x, y, z] = viewmat,
        most = [0, 0];
      for (let i = 0; i < 4 * 3000; i += 4) {
        const at = (row: readonly number[]): number =>
          [0, 1, 2].reduce((sum, a) => sum + row[a] * parts[0].centers[i + a], row[3]);
        assert.ok(at(z) > 0);
        most[0] = Math.max(most[0], Math.abs((2 * focal * at(x)) / at(z) / width));
        most[1] = Math.max(most[1], Math.abs((2 * focal * at(y)) / at(z) / height));
      }
      assert.ok(Math.max(...most) < 1, `${stretch} in ${width} x ${height}: ${most}`);
      assert.ok(Math.max(...most) > 0.75, `${stretch} in ${width} x ${height}: ${most}`);
    }
  }
});

test("a room is looked at from inside", () => {
  const parts = [scene([...sphere(8000, 0.4), ...walls(12000, 1.5)], 0.08)],
    space = new Space(coreOf(parts), parts);
  for (const [width, height] of WINDOWS) {
    const { orbit } = hands(parts);
    framed(orbit, parts, width, height);
    const { x, y, z } = orbit.pose().position;
    assert.ok(Math.max(Math.abs(x), Math.abs(y), Math.abs(z)) < 1.5, `${[x, y, z]}`);
    assert.ok(space.free([x, y, z]));
  }
});

test("a camera stops before things, goes not far away, and finds its way home", () => {
  const parts = [scene(sphere(8000, 1), 0.05)],
    { orbit, act } = hands(parts);
  framed(orbit, parts, 800, 600);
  const began = JSON.stringify([orbit.pose(), orbit.distance]),
    eye = (): number => orbit.pose().position.length();
  for (let n = 0; n < 60; n++) act("wheel", { deltaY: -200 });
  assert.ok(eye() > 1, `${eye()} from the middle`);
  for (let n = 0; n < 60; n++) act("wheel", { deltaY: 200 });
  assert.ok(eye() < 20, `${eye()} from the middle`);
  act("pointerdown", { pointerId: 1, clientX: 0, clientY: 0 });
  for (let n = 1; n < 60; n++) act("pointermove", { pointerId: 1, clientX: 400 * n, clientY: 100 * n, buttons: 2 });
  assert.ok(orbit.target.length() < 1.5, `${orbit.target}`);
  for (let n = 1; n < 200; n++) {
    act("pointermove", { pointerId: 1, clientX: 37 * n, clientY: 11 * n, buttons: 1 });
    act("wheel", { deltaY: -50 });
    assert.ok(eye() > 0.95, `${eye()} from the middle`);
  }
  orbit.home();
  assert.equal(JSON.stringify([orbit.pose(), orbit.distance]), began);
});

test("what is pointed at is as far away as it looks", () => {
  const parts = [scene(sphere(8000, 1), 0.05)],
    { orbit } = hands(parts),
    [width, height] = [800, 600];
  orbit.begin([0, 0, 0], 4);
  const camera = cameraOf(orbit.pose(), 1, width, height),
    depth = depthAt(parts, camera, width / 2, height / 2)!;
  assert.ok(Math.abs(depth - 3) < 0.15, `${depth}`);
  assert.equal(depthAt(parts, camera, 5, 5), null);
  orbit.focus(new Vec3(0, 0, 0), depth);
  assert.ok(orbit.distance < 4 && orbit.distance > 1);
});
