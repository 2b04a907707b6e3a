// Python and this code agree on bytes that nobody wrote in good faith: what a manifest may say, and the integers of
// hostile packets.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { BitstreamError } from "../src/bytes.ts";
import { StreamDecoder } from "../src/codec/decoder.ts";
import { cutOf, type Look } from "../src/codec/levels/cut.ts";
import { LevelSchema } from "../src/codec/levels/schema.ts";
import type { Swap } from "../src/codec/levels/swaps.ts";
import type { Splats } from "../src/codec/splats.ts";
import { TrackSchema } from "../src/codec/tracks/schema.ts";
import { readManifest } from "../src/packets/manifest.ts";
import type { Packet } from "../src/packets/packet.ts";
import { Received } from "../src/transport/received.ts";
import { readStream } from "./vectors.ts";

/**
 * Manifests in base64 and whether Python takes them; of streams, side information and whether it is taken, packets
 * (block, lane, count, payload in base64) and digests of their integers.
 */
interface Answers {
  readonly manifests: readonly (readonly [string, boolean])[];
  readonly heads: Readonly<Record<string, readonly (readonly [string, boolean])[]>>;
  /** Of clips, rows of every frame: track, place, turn, sizes, opacity, colour. */
  readonly frames: Readonly<Record<string, readonly (readonly (readonly number[])[])[]>>;
  /** Of streams with levels, what views show and want. */
  readonly cuts: Readonly<Record<string, readonly View[]>>;
  /** A stream with levels, of which each tile has some packets. */
  readonly tiled: string;
  /** Of streams with levels, side information and what its index of tiles says; null where it is refused. */
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
  readonly look: Look | null;
  readonly budget: number;
  readonly drawn: readonly number[];
  readonly wanted: readonly number[];
}

const path = process.env["ANSWERS"],
  answers = path ? (JSON.parse(readFileSync(path, "utf8")) as Answers) : null;
const bytesOf = (text: string): Uint8Array => Uint8Array.from(Buffer.from(text, "base64"));
const skip = answers === null && "ANSWERS names no answers of Python";

test("manifests are accepted or refused as Python does", { skip }, () => {
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

test("side information is accepted or refused as Python does", { skip }, () => {
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

test("frames of clips are those of Python, whatever is missing", { skip }, async () => {
  for (const [name, frames] of Object.entries(answers!.frames)) {
    const { head, packets } = readStream(name),
      decoder = new StreamDecoder(head);
    for (const packet of packets) assert.ok(decoder.take(packet));
    const { schema } = decoder,
      all = (): boolean => true;
    assert.ok(schema instanceof TrackSchema);
    const clip = schema.moving;
    if (decoder.intake.complete) assert.equal(await decoder.digest(), head.manifest.symbolsDigest);
    let concealed = 0;
    for (const [number, rows] of frames.entries()) {
      const { tracks, splats, concealed: guesses } = clip.frame(number, all),
        place = new Map(Array.from(tracks, (track, n) => [track, n]));
      concealed += guesses;
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
    const leftOut = name.includes("confused"); // nobody there moves as those around
    assert.equal(concealed > 0, !decoder.intake.complete && !leftOut);
  }
});

test("hostile packets are the integers that they are in Python", { skip }, async () => {
  for (const [name, cases] of Object.entries(answers!.packets)) {
    const { schema } = new StreamDecoder(readStream(name).head);
    for (const [n, [block, lane, count, payload, digest]] of cases.entries()) {
      const packet: Packet = { block, lane, count, bytes: new Uint8Array(), payload: bytesOf(payload) };
      assert.equal(await schema.digest([[packet]], async () => true), digest, `case ${n} of ${name}`);
    }
  }
});

test("views of scenes with levels show and want the tiles that they do in Python", { skip }, () => {
  for (const [name, views] of Object.entries(answers!.cuts)) {
    const { schema } = new StreamDecoder(readStream(name).head);
    assert.ok(schema instanceof LevelSchema);
    for (const { there, look, budget, ...cut } of views)
      assert.deepEqual(
        cutOf(schema.tiles, (tile) => there[tile], look, budget),
        cut,
      );
  }
});

test("indexes of tiles say what they do in Python, or are refused", { skip }, () => {
  for (const [name, cases] of Object.entries(answers!.indexes)) {
    const { head } = readStream(name);
    for (const [n, [text, said]] of cases.entries()) {
      let found: Index | null = null;
      try {
        const { schema } = new StreamDecoder({ ...head, sideInfo: bytesOf(text) });
        assert.ok(schema instanceof LevelSchema);
        const { packets, offsets, errors } = schema.tiles;
        found = { packets: [...packets], offsets: [...offsets], errors: [...errors] };
      } catch (error) {
        assert.ok(error instanceof BitstreamError, `case ${n} of ${name}: ${(error as Error).stack}`);
      }
      assert.deepEqual(found, said, `case ${n} of ${name}`);
    }
  }
});

test("the pieces of a cut are its scene, each Gaussian once", { skip }, () => {
  for (const [name, views] of Object.entries(answers!.cuts)) {
    const { head, packets } = readStream(name),
      decoder = new StreamDecoder(head),
      { schema } = decoder;
    assert.ok(schema instanceof LevelSchema);
    for (const packet of packets) assert.ok(decoder.take(packet));
    const { tiles, pieces } = schema,
      below = (tile: number): number[] => [tile, ...tiles.children[tile].flatMap(below)],
      of = (tile: number): number =>
        tiles.children[tile].length ? tiles.children[tile].reduce((sum, child) => sum + size(child), 0) : 0,
      size = (piece: number): number => schema.splatsOf(piece).reduce((sum, { count }) => sum + count, 0);
    for (let tile = 0; tile < tiles.count; tile++)
      if (tiles.children[tile].length) assert.equal(of(tile), tiles.gaussians[tile]);
      else assert.equal(size(tiles.count + tile), tiles.gaussians[tile]);
    for (const { drawn } of views) {
      const covered = pieces.drawn({ drawn, wanted: [] }).flatMap((piece) => {
        const { tile, instead } = pieces.of(piece);
        return below(instead ?? tile).filter((finest) => !tiles.children[finest].length);
      });
      assert.equal(new Set(covered).size, covered.length);
      const roots = drawn.filter((tile) => tiles.parents[tile] < 0).flatMap(below);
      assert.equal(covered.length, roots.filter((tile) => !tiles.children[tile].length).length);
    }
  }
});

test("a tile is drawn when most of it is there, and once more with what came late", { skip }, () => {
  const { head, packets } = readStream(answers!.tiled),
    received = new Received(head),
    tiling = received.decoder.schema.tiling!,
    { tiles, pieces } = tiling,
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
    for (const { gone, come } of swaps) {
      for (const piece of gone) held.delete(piece);
      for (const piece of come) held.set(piece, tiling.splatsOf(piece).length);
    }
    return swaps;
  };
  const isDrawn = (): boolean => [...held.keys()].some((piece) => pieces.of(piece).tile === finer);
  const late = of(finer).slice(0, Math.floor(tiles.packets[finer] / 4) + 1);
  assert.ok(late.length > 1);
  for (const bytes of [...of(0), ...of(finer).slice(late.length)]) received.take(bytes);
  show();
  assert.ok(!isDrawn() && held.size === tiles.children[0].length);
  received.take(late.pop()!);
  show();
  assert.ok(isDrawn() && tiling.wanted.includes(finer));
  for (const bytes of late) received.take(bytes);
  assert.ok(show().some(({ gone, come }) => gone.length === 1 && gone[0] === come[0]));
  assert.ok(isDrawn() && !tiling.wanted.includes(finer));
  assert.deepEqual(show(), []);
});
