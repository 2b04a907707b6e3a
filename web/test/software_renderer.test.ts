import assert from "node:assert/strict";
import { test } from "node:test";

import { Quat, Vec3 } from "playcanvas";

import { emptySplats, type Splats } from "../src/codec/splats.ts";
import { pack } from "../src/render/packed.ts";
import type { Pose } from "../src/render/projection.ts";
import { pixels } from "../src/render/software_renderer.ts";

const WIDTH = 40,
  HEIGHT = 30,
  BACKGROUND = [0.1, 0.5, 0.9];

function cloud(count: number): Splats {
  let state = 7;
  const random = (): number => (state = (state * 16807) % 2147483647) / 2147483647;
  const splats = emptySplats(count, 0);
  for (let i = 0; i < count; i++) {
    for (let a = 0; a < 3; a++) {
      splats.means[3 * i + a] = 2 * random() - 1;
      splats.scales[3 * i + a] = 0.02 + 0.3 * random() ** 3;
      splats.colours[3 * i + a] = random();
    }
    const turn = new Quat(random() - 0.5, random() - 0.5, random() - 0.5, random()).normalize();
    splats.quats.set([turn.w, turn.x, turn.y, turn.z], 4 * i);
    splats.opacities[i] = 0.1 + 0.9 * random();
  }
  return splats;
}

/** Reference renderer: for each pixel all Gaussians in depth order, with covariance matrices. */
function reference(splats: Splats, { position, rotation }: Pose): number[] {
  const focal = HEIGHT / 2 / Math.tan((25 * Math.PI) / 180),
    view = rotation.clone().invert();
  const seen = Array.from({ length: splats.count }, (_, i) => {
    const [mx, my, mz] = splats.means.subarray(3 * i, 3 * i + 3),
      [w, x, y, z] = splats.quats.subarray(4 * i, 4 * i + 4);
    const centre = view.transformVector(new Vec3(mx, my, mz).sub(position), new Vec3()),
      depth = -centre.z,
      turn = new Quat(x, y, z, w);
    const tx = Math.min(Math.max(centre.x / depth, (-1.3 * WIDTH) / 2 / focal), (1.3 * WIDTH) / 2 / focal);
    const ty = Math.min(Math.max(centre.y / depth, (-1.3 * HEIGHT) / 2 / focal), (1.3 * HEIGHT) / 2 / focal);
    const columns = [0, 1, 2].map((a) => {
      const axis = new Vec3(a === 0 ? 1 : 0, a === 1 ? 1 : 0, a === 2 ? 1 : 0).mulScalar(splats.scales[3 * i + a]);
      const v = view.transformVector(turn.transformVector(axis, new Vec3()), new Vec3());
      return [(focal / depth) * (v.x + tx * v.z), (-focal / depth) * (v.y + ty * v.z)];
    });
    const sum = (m: number, n: number): number => columns.reduce((all, column) => all + column[m] * column[n], 0);
    return {
      i,
      depth,
      x: WIDTH / 2 + (focal * centre.x) / depth,
      y: HEIGHT / 2 - (focal * centre.y) / depth,
      xx: sum(0, 0) + 0.3,
      xy: sum(0, 1),
      yy: sum(1, 1) + 0.3,
    };
  })
    .filter(({ depth }) => depth > 0.01)
    .sort((a, b) => a.depth - b.depth);
  const out: number[] = [];
  for (let p = 0; p < WIDTH * HEIGHT; p++) {
    const colour = [0, 0, 0];
    let passes = 1;
    for (const { i, x, y, xx, xy, yy } of seen) {
      const dx = (p % WIDTH) + 0.5 - x,
        dy = Math.floor(p / WIDTH) + 0.5 - y,
        q = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy);
      const alpha = Math.min(splats.opacities[i] * Math.exp(-q / 2), 0.99);
      if (alpha < 1 / 255) continue;
      for (let c = 0; c < 3; c++) colour[c] += passes * alpha * splats.colours[3 * i + c];
      passes *= 1 - alpha;
    }
    out.push(...colour.map((value, c) => 255 * Math.min(value + passes * BACKGROUND[c], 1)), 255);
  }
  return out;
}

test("painted pictures equal the reference, from outside and inside the scene", () => {
  const splats = cloud(150),
    packed = pack([splats], 0, 1);
  for (const [position, rotation] of [
    [new Vec3(0, 0, 4), new Quat()],
    [new Vec3(0.5, -3, 1), new Quat().setFromEulerAngles(70, 20, 10)],
    [new Vec3(), new Quat().setFromEulerAngles(0, 90, 0)],
  ] as const) {
    const found = pixels({ parts: [packed], background: BACKGROUND, pose: { position, rotation } }, WIDTH, HEIGHT),
      expected = reference(splats, { position, rotation });
    const off = expected.map((value, p) => Math.abs(value - found[p])),
      mean = off.reduce((sum, value) => sum + value, 0) / off.length;
    // Depth buckets and the falloff table cause small differences.
    assert.ok(mean < 0.5 && Math.max(...off) < 24, `${mean} ${Math.max(...off)}`);
  }
});
