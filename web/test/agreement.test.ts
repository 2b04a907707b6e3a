// Python and TypeScript accept the same manifests and decode hostile packets to the same integers.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import { StreamDecoder } from "../src/codec/decoder.ts";
import { cutOf, type ViewCamera } from "../src/codec/levels/cut.ts";
import { LevelDecoder } from "../src/codec/levels/level_decoder.ts";
import type { Swap } from "../src/codec/levels/swaps.ts";
import type { Splats } from "../src/codec/splats.ts";
import { TrackDecoder } from "../src/codec/tracks/track_decoder.ts";
import { readManifest } from "../src/packets/manifest.ts";
import type { Packet } from "../src/packets/packet.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import { readStream } from "./vectors.ts";

/**
 * Answers of the Python decoder: manifests in base64 and whether each is accepted. For streams: side information and
 * whether it is accepted, packets (block, index in it, count, payload in base64) and digests of their integers.
 */
interface Answers {
  readonly manifests: readonly (readonly [string, boolean])[];
  readonly heads: Readonly<Record<string, readonly (readonly [string, boolean])[]>>;
  /** Rows of every frame of clips: track, position, rotation, sizes, opacity, colour. */
  readonly frames: Readonly<Record<string, readonly (readonly (readonly number[])[])[]>>;
  /** Drawn and missing tiles of views, for streams with levels. */
  readonly cuts: Readonly<Record<string, readonly View[]>>;
  /** Stream with levels and several packets per tile. */
  readonly tiled: string;
  /** Side information of streams with levels and the content of its tile index; null if invalid. */
  readonly indexes: Readonly<Record<string, readonly (readonly [string, Index | null])[]>>;
  readonly packets: Readonly<Record<string, readonly (readonly [number, number, number, string, string])[]>>;
}

interface Index {
  readonly packets: readonly number[];
  readonly offsets: readonly number[];
  readonly errors: readonly number[];
}

interface View {
  readonly there: readonly boolean[];
  readonly look: ViewCamera | null;
  readonly budget: number;
  readonly drawn: readonly number[];
  readonly wanted: readonly number[];
}

const path = process.env["ANSWERS"],
  answers = path ? (JSON.parse(readFileSync(path, "utf8")) as Answers) : null;
const bytesOf = (text: string): Uint8Array => Uint8Array.from(Buffer.from(text, "base64"));
const skip = answers === null && "ANSWERS is not set";

test("the same manifests are accepted as in Python", { skip }, () => {
  for (const [text, accepted] of answers!.manifests) {
    let why = "";
    try {
      readManifest(bytesOf(text));
    } catch (error) {
      assert.ok(
        error instanceof BitstreamError,
        `${Buffer.from(text, "base64").toString()}: ${(error as Error).stack}`,
      );
      why = error.message;
    }
    assert.equal(why === "", accepted, `${Buffer.from(text, "base64").toString()}: ${why || "accepted"}`);
  }
});

test("the same side information is accepted as in Python", { skip }, () => {
  for (const [name, cases] of Object.entries(answers!.heads)) {
    const { head } = readStream(name);
    cases.forEach(([text, accepted], n) => {
      let why = "";
      try {
        new StreamDecoder({ ...head!, sideInfo: bytesOf(text) });
      } catch (error) {
        assert.ok(error instanceof BitstreamError, `case ${n} of ${name}: ${(error as Error).stack}`);
        why = error.message;
      }
      assert.equal(why === "", accepted, `case ${n} of ${name}: ${why || "accepted"}`);
    });
  }
});

test("clip frames equal those of Python, with any packets missing", { skip }, async () => {
  for (const [name, frames] of Object.entries(answers!.frames)) {
    const { head, packets } = readStream(name),
      decoder = new StreamDecoder(head);
    for (const packet of packets) assert.ok(decoder.addPacket(packet));
    const { elementDecoder } = decoder,
      all = (): boolean => true;
    assert.ok(elementDecoder instanceof TrackDecoder);
    const clip = elementDecoder.sequence;
    if (decoder.intake.complete) assert.equal(await decoder.digest(), head.manifest.symbolsDigest);
    let total = 0;
    for (const [number, rows] of frames.entries()) {
      const { tracks, splats, numConcealed } = clip.frame(number, all),
        place = new Map(Array.from(tracks, (track, n) => [track, n]));
      total += numConcealed;
      assert.equal(tracks.length, rows.length, `frame ${number} of ${name}`);
      for (const [track, ...values] of rows) {
        const n = place.get(track)!,
          { means, quats, scales, opacities, colours }: Splats = splats,
          sign = Math.sign(quats[4 * n] * values[3] + quats[4 * n + 1] * values[4]) || 1,
          found: number[] = [
            ...means.subarray(3 * n, 3 * n + 3),
            ...quats.subarray(4 * n, 4 * n + 4).map((value: number) => value * sign),
            ...scales.subarray(3 * n, 3 * n + 3),
            opacities[n],
            ...colours.subarray(3 * n, 3 * n + 3),
          ];
        for (const [i, value] of values.entries())
          assert.ok(
            Math.abs(found[i] - value) < 2e-3,
            `frame ${number} of ${name}, track ${track}: ${found} ${values}`,
          );
      }
    }
    const hidesAll = name.includes("repeated"); // its motion is not similar enough to be interpolated
    assert.equal(total > 0 || hidesAll, !decoder.intake.complete);
  }
});

test("hostile packets decode to the same integers as in Python", { skip }, async () => {
  for (const [name, cases] of Object.entries(answers!.packets)) {
    const { elementDecoder } = new StreamDecoder(readStream(name).head);
    for (const [n, [block, indexInBlock, count, payload, digest]] of cases.entries()) {
      const packet: Packet = { block, indexInBlock, count, bytes: new Uint8Array(), payload: bytesOf(payload) };
      assert.equal(await elementDecoder.digest([[packet]], async () => true), digest, `case ${n} of ${name}`);
    }
  }
});

test("views of scenes with levels select the same tiles as in Python", { skip }, () => {
  for (const [name, views] of Object.entries(answers!.cuts)) {
    const { elementDecoder } = new StreamDecoder(readStream(name).head);
    assert.ok(elementDecoder instanceof LevelDecoder);
    for (const { there, look, budget, ...cut } of views)
      assert.deepEqual(
        cutOf(elementDecoder.tiles, (tile) => there[tile], look, budget),
        cut,
      );
  }
});

test("tile indexes are read or rejected as in Python", { skip }, () => {
  for (const [name, cases] of Object.entries(answers!.indexes)) {
    const { head } = readStream(name);
    for (const [n, [text, said]] of cases.entries()) {
      let found: Index | null = null;
      try {
        const { elementDecoder } = new StreamDecoder({ ...head, sideInfo: bytesOf(text) });
        assert.ok(elementDecoder instanceof LevelDecoder);
        const { numPackets, offsets, errors } = elementDecoder.tiles;
        found = { packets: [...numPackets], offsets: [...offsets], errors: [...errors] };
      } catch (error) {
        assert.ok(error instanceof BitstreamError, `case ${n} of ${name}: ${(error as Error).stack}`);
      }
      assert.deepEqual(found, said, `case ${n} of ${name}`);
    }
  }
});

test("the units of a cut cover the scene exactly once", { skip }, () => {
  for (const [name, views] of Object.entries(answers!.cuts)) {
    const { head, packets } = readStream(name),
      decoder = new StreamDecoder(head),
      { elementDecoder } = decoder;
    assert.ok(elementDecoder instanceof LevelDecoder);
    for (const packet of packets) assert.ok(decoder.addPacket(packet));
    const { tiles, drawUnits } = elementDecoder,
      below = (tile: number): number[] => [tile, ...tiles.children[tile].flatMap(below)],
      of = (tile: number): number =>
        tiles.children[tile].length ? tiles.children[tile].reduce((sum, child) => sum + size(child), 0) : 0,
      size = (unit: number): number => elementDecoder.splatsOf(unit).reduce((sum, { count }) => sum + count, 0);
    for (let tile = 0; tile < tiles.count; tile++)
      if (tiles.children[tile].length) assert.equal(of(tile), tiles.numGaussians[tile]);
      else assert.equal(size(tiles.count + tile), tiles.numGaussians[tile]);
    for (const { drawn } of views) {
      const covered = drawUnits.drawn({ drawn, wanted: [] }).flatMap((unit) => {
        const { tile, child } = drawUnits.of(unit);
        return below(child ?? tile).filter((finest) => !tiles.children[finest].length);
      });
      assert.equal(new Set(covered).size, covered.length);
      const roots = drawn.filter((tile) => tiles.parents[tile] < 0).flatMap(below);
      assert.equal(covered.length, roots.filter((tile) => !tiles.children[tile].length).length);
    }
  }
});

test("a tile is drawn once most packets arrived, and redrawn with late packets", { skip }, () => {
  const { head, packets } = readStream(answers!.tiled),
    received = new DecodedStream(head),
    tiling = received.decoder.elementDecoder.tiling!,
    { tiles, drawUnits } = tiling,
    finer = tiles.children[0][0],
    of = (tile: number): Uint8Array[] => packets.slice(tiles.firstPackets[tile], tiles.firstPackets[tile + 1]),
    near = {
      viewmat: [
        [1, 0, 0, 0],
        [0, 1, 0, 0],
        [0, 0, 1, 0],
      ],
      focal: 1e9,
      width: 100,
      height: 100,
      margin: 0,
    },
    held = new Map<number, number>();
  const show = (): readonly Swap[] => {
    const swaps = received.swaps(near, held);
    for (const { removed, added } of swaps) {
      for (const unit of removed) held.delete(unit);
      for (const unit of added) held.set(unit, tiling.splatsOf(unit).length);
    }
    return swaps;
  };
  const isDrawn = (): boolean => [...held.keys()].some((unit) => drawUnits.of(unit).tile === finer);
  const late = of(finer).slice(0, Math.floor(tiles.numPackets[finer] / 4) + 1);
  assert.ok(late.length > 1);
  for (const bytes of [...of(0), ...of(finer).slice(late.length)]) received.addPacket(bytes);
  show();
  assert.ok(!isDrawn() && held.size === tiles.children[0].length);
  received.addPacket(late.pop()!);
  show();
  assert.ok(isDrawn() && tiling.wanted.includes(finer));
  for (const bytes of late) received.addPacket(bytes);
  assert.ok(show().some(({ removed, added }) => removed.length === 1 && removed[0] === added[0]));
  assert.ok(isDrawn() && !tiling.wanted.includes(finer));
  assert.deepEqual(show(), []);
});
