import assert from "node:assert/strict";
import { test } from "node:test";

import { Vec3 } from "playcanvas";

import { Orbit } from "../src/render/orbit.ts";

const RADIANS = Math.PI / 180;

/** Returns the distance of the eye from the target and its angle from the up axis, degrees. */
function polarOf(orbit: Orbit): [number, number] {
  const { eye, target, up } = orbit.viewpoint(),
    away = new Vec3().sub2(eye, target);
  return [away.length(), Math.acos(away.normalize().dot(up)) / RADIANS];
}

const near = (found: readonly number[], wanted: readonly number[]): void => {
  for (const [n, value] of found.entries()) assert.ok(Math.abs(value - wanted[n]) < 1e-4, `${found} is not ${wanted}`);
};

test("limits hold for every movement, the first view, and after a change of units", () => {
  const orbit = new Orbit(() => undefined);
  orbit.begin([0, 0, 0], 10);
  orbit.limit({ near: 2, far: 3, low: -30 * RADIANS, high: -10 * RADIANS });
  assert.equal(polarOf(orbit)[0], 3);
  for (let n = 0; n < 20; n++) orbit.zoom(0.8);
  orbit.rotate(1, 5);
  near(polarOf(orbit), [2, 80]);
  for (let n = 0; n < 20; n++) orbit.zoom(1.3);
  orbit.rotate(1, -5);
  near(polarOf(orbit), [3, 60]);
  orbit.reset();
  assert.ok(polarOf(orbit)[0] <= 3);
  orbit.rescale(10);
  orbit.zoom(2);
  near(polarOf(orbit).slice(0, 1), [30]);
  orbit.limit(null);
  orbit.zoom(2);
  near(polarOf(orbit).slice(0, 1), [60]);
});

test("a movement between two states ends in the second one, on the shorter way", () => {
  for (const turned of [false, true]) {
    const orbit = new Orbit(() => undefined);
    orbit.turned = turned;
    orbit.begin([1, 2, 3], 4, 3);
    const from = orbit.state,
      eye = new Vec3(2, -1, 0.5),
      target = new Vec3(-1, 0.3, 0),
      to = orbit.stateOf(eye, target);
    orbit.moveBetween(from, { ...to, yaw: -3 }, 0.5);
    assert.ok(Math.abs(Math.cos(orbit.yaw) + 1) < 0.02, "through 180 degrees, not through 0");
    orbit.moveBetween(from, to, 1);
    const found = orbit.viewpoint();
    near([found.eye.x, found.eye.y, found.eye.z], [2, -1, 0.5]);
    near([found.target.x, found.target.y, found.target.z], [-1, 0.3, 0]);
  }
});

test("another up axis leaves the eye and the target in place", () => {
  const orbit = new Orbit(() => undefined);
  orbit.turned = true;
  orbit.begin([1, 2, 3], 4);
  const { eye, target } = orbit.viewpoint(),
    up = new Vec3(0.6, 0, 0.8);
  orbit.reorient(up);
  const found = orbit.viewpoint();
  near([found.eye.x, found.eye.y, found.eye.z], [eye.x, eye.y, eye.z]);
  near([found.target.x, found.target.y, found.target.z], [target.x, target.y, target.z]);
  near([found.up.x, found.up.y, found.up.z], [0.6, 0, 0.8]);
});

test("a movement from far away arrives, and an eye at its target keeps the direction", () => {
  const orbit = new Orbit(() => undefined);
  orbit.begin([1, 2, 3], 4);
  const to = orbit.state,
    away = orbit.stateOf(new Vec3(1e15, 0, 0), new Vec3());
  orbit.moveBetween(to, away, 1);
  orbit.moveBetween(orbit.state, to, 1);
  assert.deepEqual(orbit.state, to);
  const same = orbit.stateOf(new Vec3(5, 6, 7), new Vec3(5, 6, 7));
  assert.deepEqual(same, { ...to, target: new Vec3(5, 6, 7) });
});

test("limits that are removed do not stay in the initial state, and rotations stay finite", () => {
  const orbit = new Orbit(() => undefined);
  orbit.limit({ near: 1e30, far: 1e30, low: 0, high: 0 });
  orbit.begin([0, 0, 0], 4);
  assert.equal(orbit.distance, 1e30);
  orbit.limit(null);
  orbit.reset();
  assert.equal(orbit.distance, 4);
  for (let n = 0; n < 4; n++) orbit.rotate(1e308, 0);
  assert.ok(Number.isFinite(orbit.yaw));
});
