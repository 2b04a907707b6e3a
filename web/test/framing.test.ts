import assert from "node:assert/strict";
import { test } from "node:test";

import { Vec3 } from "playcanvas";

import type { Splats } from "../src/codec/splats.ts";
import { Controls } from "../src/render/controls.ts";
import { frameScene, sceneCore } from "../src/render/framing.ts";
import { FreeSpace } from "../src/render/free_space.ts";
import { Orbit } from "../src/render/orbit.ts";
import { type Packed, pack } from "../src/render/packed.ts";
import { pickDepth, pickPoint } from "../src/render/pick.ts";
import { cameraFromPose, halfHeight } from "../src/render/projection.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { random, readStream } from "./vectors.ts";

const WINDOWS = [
  [1280, 760],
  [390, 790],
  [600, 100],
] as const;

/** Round opaque Gaussians at the given points. */
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

/** Random points on a sphere. */
function sphere(count: number, radius: number, stretch: readonly number[] = [1, 1, 1]): number[][] {
  return Array.from({ length: count }, () => {
    const point = [normal(), normal(), normal()],
      length = Math.hypot(...point);
    return point.map((value, a) => (radius * stretch[a] * value) / length);
  });
}

/** Random points on the walls of a box. */
function walls(count: number, half: number): number[][] {
  return Array.from({ length: count }, (_, n) => {
    const point = [0, 1, 2].map(() => half * (2 * draw() - 1));
    point[n % 3] = n % 2 ? half : -half;
    return point;
  });
}

const WIDTH = 800,
  HEIGHT = 600;

interface Handled {
  orbit: Orbit;
  act(kind: string, event: object): void;
}

/** Camera with controls in a window of 800 x 600 pixels. */
function hands(parts: readonly Packed[]): Handled {
  const events = new Map<string, (event: unknown) => void>(),
    canvas = {
      clientHeight: HEIGHT,
      addEventListener: (kind: string, take: (event: unknown) => void) => events.set(kind, take),
      setPointerCapture: () => undefined,
    },
    space = new FreeSpace(sceneCore(parts), parts);
  const orbit: Orbit = new Orbit(
    () => undefined,
    () => space,
    (at) => {
      const { x, y } = at ?? { x: WIDTH / 2, y: HEIGHT / 2 },
        point = pickPoint(parts, cameraFromPose(orbit.pose(), 1, WIDTH, HEIGHT), x, y);
      return point && new Vec3(...point);
    },
  );
  new Controls(canvas as unknown as HTMLElement, orbit);
  return { orbit, act: (kind, event) => events.get(kind)!({ target: {}, preventDefault: () => undefined, ...event }) };
}

function framed(orbit: Orbit, parts: readonly Packed[], width: number, height: number): void {
  const core = sceneCore(parts),
    down = halfHeight(width, height);
  frameScene(orbit, core, new FreeSpace(core, parts), (down * width) / height, down);
}

test("a scene fits windows of any aspect ratio and fills one dimension", () => {
  for (const stretch of [
    [1, 3, 1],
    [3, 1, 1],
    [1, 1, 1],
  ]) {
    const far = [40, 40, 40], // outlier
      parts = [scene([...sphere(3000, 1, stretch), far], 0.05)];
    for (const [width, height] of WINDOWS) {
      const { orbit } = hands(parts);
      framed(orbit, parts, width, height);
      const { viewmat, focal } = cameraFromPose(orbit.pose(), 1, width, height),
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

test("a moving scene fits in all its frames", () => {
  const parts = [scene([...sphere(1500, 1), ...sphere(1000, 0.7), ...sphere(500, 0.4)], 0.05)],
    everywhere = scene(
      sphere(3000, 4).map(([x, y, z]) => [x + 2, y, z]),
      0.05,
    );
  for (const [width, height] of WINDOWS) {
    const { orbit } = hands(parts),
      core = sceneCore(parts),
      down = halfHeight(width, height),
      across = (down * width) / height;
    frameScene(orbit, core, new FreeSpace(core, parts), across, down, { middle: [2, 0, 0], radius: 4 });
    const { viewmat, focal } = cameraFromPose(orbit.pose(), 1, width, height),
      [x, y, z] = viewmat;
    let most = 0;
    for (let i = 0; i < 4 * 3000; i += 4) {
      const at = (row: readonly number[]): number =>
        [0, 1, 2].reduce((sum, a) => sum + row[a] * everywhere.centers[i + a], row[3]);
      assert.ok(at(z) > 0);
      most = Math.max(
        most,
        Math.abs((2 * focal * at(x)) / at(z) / width),
        Math.abs((2 * focal * at(y)) / at(z) / height),
      );
    }
    assert.ok(most < 1.02 && most > 0.75, `${most} in ${width} x ${height}`);
  }
});

for (const name of ["tiny_levels", "tiny_clip", "tiny_shots"])
  test(`the framing Gaussians of ${name} are the same in any order of arrival, and none before all arrived`, () => {
    const { head, packets } = readStream(`../tests/golden/${name}.swz`),
      found = [packets, [...packets].reverse()].map((order) => {
        const stream = new DecodedStream(head),
          results = new Set<string>();
        assert.equal(stream.framingGaussians, null);
        for (const bytes of order) {
          stream.addPacket(bytes);
          const framing = stream.framingGaussians;
          if (framing) results.add(JSON.stringify(framing));
        }
        assert.equal(results.size, 1, "later packets change them");
        return [...results][0];
      });
    assert.ok(found[0] === found[1], "the order of arrival changes them");
  });

test("a room is viewed from inside", () => {
  const parts = [scene([...sphere(8000, 0.4), ...walls(12000, 1.5)], 0.08)],
    space = new FreeSpace(sceneCore(parts), parts);
  for (const [width, height] of WINDOWS) {
    const { orbit } = hands(parts);
    framed(orbit, parts, width, height);
    const { x, y, z } = orbit.pose().position;
    assert.ok(Math.max(Math.abs(x), Math.abs(y), Math.abs(z)) < 1.5, `${[x, y, z]}`);
    assert.ok(space.isFree([x, y, z]));
  }
});

test("the camera stops at obstacles, stays within its limits and returns home", () => {
  const parts = [scene(sphere(8000, 1), 0.05)],
    { orbit, act } = hands(parts);
  framed(orbit, parts, 800, 600);
  const began = JSON.stringify([orbit.pose(), orbit.distance]),
    eye = (): number => orbit.pose().position.length();
  for (let n = 0; n < 60; n++) act("wheel", { deltaY: -200, offsetX: 400, offsetY: 300 });
  assert.ok(eye() > 1, `${eye()} from the middle`);
  for (let n = 0; n < 60; n++) act("wheel", { deltaY: 200, offsetX: 400, offsetY: 300 });
  assert.ok(eye() < 20, `${eye()} from the middle`);
  act("pointerdown", { pointerId: 1, offsetX: 0, offsetY: 0 });
  for (let n = 1; n < 60; n++) act("pointermove", { pointerId: 1, offsetX: 400 * n, offsetY: 100 * n, buttons: 2 });
  assert.ok(orbit.target.length() < 1.5, `${orbit.target}`);
  for (let n = 1; n < 200; n++) {
    act("pointermove", { pointerId: 1, offsetX: 37 * n, offsetY: 11 * n, buttons: 1 });
    act("wheel", { deltaY: -50, offsetX: 400, offsetY: 300 });
    assert.ok(eye() > 0.95, `${eye()} from the middle`);
  }
  orbit.reset();
  assert.equal(JSON.stringify([orbit.pose(), orbit.distance]), began);
});

test("the automatic rotation does not move a reframed camera into an obstacle", () => {
  const beside = Array.from({ length: 6000 }, (_, n) => [
    (n % 2 ? 3 : -3) + 0.2 * normal(),
    0.2 * normal(),
    0.2 * normal(),
  ]);
  const parts = [scene(sphere(4000, 1), 0.05), scene(beside, 0.05)],
    space = new FreeSpace(sceneCore(parts), parts),
    { orbit } = hands(parts);
  const isFree = (): boolean => {
    const { x, y, z } = orbit.pose().position;
    return space.isFree([x, y, z]);
  };
  orbit.pitch = 0;
  orbit.begin([0, 0, 0], 6, 0);
  orbit.drift(Math.PI / 2);
  assert.equal(orbit.distance, 6);
  orbit.begin([0, 0, 0], 3, 0);
  assert.ok(orbit.distance < 3);
  assert.ok(Math.abs(orbit.yaw - Math.PI / 2) < 1e-6);
  assert.ok(isFree());
  assert.equal(orbit.touched, false);
});

test("picking returns the depth of the visible surface", () => {
  const parts = [scene(sphere(8000, 1), 0.05)],
    { orbit } = hands(parts),
    [width, height] = [800, 600];
  orbit.begin([0, 0, 0], 4);
  const camera = cameraFromPose(orbit.pose(), 1, width, height),
    depth = pickDepth(parts, camera, width / 2, height / 2)!;
  assert.ok(Math.abs(depth - 3) < 0.15, `${depth}`);
  assert.equal(pickDepth(parts, camera, 5, 5), null);
  orbit.focus({ x: width / 2, y: height / 2 });
  assert.ok(Math.abs(orbit.target.length() - 1) < 0.15, `${orbit.target}`);
  assert.ok(orbit.distance < depth && orbit.distance > 1);
});

/** Returns the share of the window in which the scene is drawn. */
function drawn(orbit: Orbit, parts: readonly Packed[]): number {
  const camera = cameraFromPose(orbit.pose(), 1, WIDTH, HEIGHT),
    [across, down] = [16, 12],
    places = Array.from({ length: across * down }, (_, n) => [n % across, Math.floor(n / across)]);
  const found = places.filter(
    ([i, j]) => pickDepth(parts, camera, ((i + 0.5) * WIDTH) / across, ((j + 0.5) * HEIGHT) / down) !== null,
  );
  return found.length / places.length;
}

/** A body and a thin slanted neck. The centre of the scene is outside both. */
function guitar(): Packed {
  const neck = Array.from({ length: 1000 }, () => {
    const along = draw();
    return [0.6 + 2 * along + 0.03 * normal(), 0.4 + 1.5 * along + 0.03 * normal(), 0.03 * normal()];
  });
  return scene([...sphere(2500, 0.5), ...neck], 0.02);
}

test("zooming in ends at the scene, for any pointer position", () => {
  const parts = [guitar()];
  for (const [offsetX, offsetY] of [
    [400, 300],
    [100, 100],
    [700, 500],
  ]) {
    const { orbit, act } = hands(parts);
    framed(orbit, parts, WIDTH, HEIGHT);
    const began = orbit.distance;
    for (let n = 0; n < 36; n++) {
      act("wheel", { deltaY: -200, offsetX, offsetY });
      if (n % 6 === 5)
        assert.ok(drawn(orbit, parts) > 0.03, `${drawn(orbit, parts)} after ${n} steps at ${offsetX}, ${offsetY}`);
    }
    assert.ok(orbit.distance < began / 2.5, `${orbit.distance} of ${began}`);
    for (let n = 0; n < 12; n++) {
      orbit.rotate(0.5, 0.2);
      if (n % 3 === 2)
        assert.ok(drawn(orbit, parts) > 0.01, `${drawn(orbit, parts)} after ${n} turns at ${offsetX}, ${offsetY}`);
    }
  }
});

test("zooming in moves the point under the pointer towards the centre", () => {
  const parts = [scene(sphere(8000, 1), 0.05)],
    { orbit, act } = hands(parts);
  framed(orbit, parts, WIDTH, HEIGHT);
  const [px, py] = [480, 220],
    point = pickPoint(parts, cameraFromPose(orbit.pose(), 1, WIDTH, HEIGHT), px, py)!;
  let before = Math.hypot(px - WIDTH / 2, py - HEIGHT / 2);
  for (let n = 0; n < 30; n++) {
    act("wheel", { deltaY: -120, offsetX: px, offsetY: py });
    const { viewmat, focal } = cameraFromPose(orbit.pose(), 1, WIDTH, HEIGHT),
      [x, y, z] = viewmat.map((row) => row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]),
      away = (focal * Math.hypot(x, y)) / z;
    assert.ok(away <= before + 0.5, `${away} pixels from the middle after ${before}`);
    before = away;
  }
  assert.ok(before < 0.6 * Math.hypot(px - WIDTH / 2, py - HEIGHT / 2), `${before} pixels from the middle`);
});

test("panning stops before the scene leaves the view", () => {
  const parts = [guitar()],
    { orbit, act } = hands(parts);
  framed(orbit, parts, WIDTH, HEIGHT);
  for (let n = 0; n < 20; n++) act("wheel", { deltaY: -120, offsetX: 400, offsetY: 300 });
  const began = orbit.target.clone();
  for (let n = 0; n < 40; n++) orbit.pan(0.05, 0.03);
  assert.ok(orbit.target.distance(began) > 0);
  assert.ok(drawn(orbit, parts) > 0, "an empty picture");
});
