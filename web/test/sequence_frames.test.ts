// Frames for the page: empty ones are shown, those that have not arrived are not.

import assert from "node:assert/strict";
import { test } from "node:test";

import { emptySplats } from "../src/codec/splats.ts";
import { KeyframeGaussians, TRACK_BYTES } from "../src/codec/tracks/keyframe_gaussians.ts";
import { Sequence } from "../src/codec/tracks/sequence.ts";
import type { TrackDecoder } from "../src/codec/tracks/track_decoder.ts";
import type { Packet } from "../src/packets/packet.ts";
import { SequenceFrames } from "../src/sequence_frames.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import type { FromWorker } from "../src/transport/messages.ts";
import { readStream } from "./vectors.ts";

const simulation = { concealer: "motion", lossRate: 0, burstLength: 1, seed: 0, sentShare: 1 };

/** Returns the Gaussians of each frame of a stream that the page gets. */
function framesOf(received: DecodedStream): { count: number; opacities: Float32Array }[] {
  const said: FromWorker[] = [],
    frames = new SequenceFrames((message) => said.push(message));
  for (let number = 0; number < received.decoder.elementDecoder.sequence!.timeline.numFrames; number++)
    frames.frame({ kind: "frame", number, simulation }, received, 1);
  return said.flatMap((one) => (one.kind === "frame" ? [one.packed] : []));
}

test("a frame without Gaussians is drawn as an invisible one once its packets have arrived", () => {
  const { head, packets } = readStream("../tests/golden/tiny_clip.swz"),
    received = new DecodedStream(head),
    sequence = received.decoder.elementDecoder.sequence!,
    plain = sequence.frame.bind(sequence);
  assert.ok(framesOf(received).every(({ count }) => count === 0));
  for (const packet of packets) received.addPacket(packet);
  assert.ok(framesOf(received).every(({ count }) => count > 1));
  sequence.frame = (...given) => ({
    ...plain(...given),
    splats: emptySplats(0, received.decoder.elementDecoder.degree),
  });
  for (const { count, opacities } of framesOf(received)) assert.deepEqual([count, ...opacities], [1, 0]);
});

test("the limit of memory counts all arrays of a track", () => {
  const { head } = readStream("../tests/golden/tiny_clip.swz"),
    decoder = new DecodedStream(head).decoder.elementDecoder as TrackDecoder,
    { tracks, birthGroups, positions, shifts } = new KeyframeGaussians(decoder.info),
    bytes = [tracks, birthGroups, positions, shifts].reduce((sum, { byteLength }) => sum + byteLength, 0);
  assert.equal(TRACK_BYTES, bytes / tracks.length);
});

test("bytes of motion packets are released with their group", () => {
  const { head, packets } = readStream("../tests/golden/tiny_clip.swz"),
    { decoder } = new DecodedStream(head),
    { sequence } = decoder.elementDecoder;
  let numMotion = 0;
  for (const bytes of packets) {
    const { packet } = decoder.addPacket(bytes)!;
    if (decoder.intake.plan.isKeyframe(packet!.block)) continue;
    numMotion++;
    assert.deepEqual([packet!.bytes.length, packet!.payload.length], [0, 0]);
  }
  assert.ok(numMotion);
  assert.equal(sequence!.packets.length, numMotion);
  decoder.intake.forget(sequence!.forgetMotion(sequence!.timeline.groupFrames));
  assert.ok(sequence!.packets.length < numMotion);
});

test("bytes of motion packets that arrive after their group are released with the next", () => {
  const { head, packets } = readStream("../tests/golden/tiny_clip.swz"),
    { decoder } = new DecodedStream(head),
    { sequence } = decoder.elementDecoder,
    isOfFirstGroup = ({ block }: Packet): boolean =>
      !decoder.intake.plan.isKeyframe(block) && decoder.intake.plan.gopOf(block) === 0,
    held = (): number =>
      [...decoder.intake.blocks.values()]
        .flat()
        .filter(isOfFirstGroup)
        .reduce((sum, { bytes }) => sum + bytes.length, 0);
  decoder.intake.forget(sequence!.forgetMotion(sequence!.timeline.groupFrames));
  for (const bytes of packets) decoder.addPacket(bytes);
  assert.ok(sequence!.numLatePackets && held());
  decoder.intake.forget(sequence!.forgetMotion(sequence!.timeline.groupFrames));
  assert.equal(held(), 0);
});

test("a group of frames is whole once all its packets have arrived", () => {
  const { head, packets } = readStream("../tests/golden/tiny_clip.swz"),
    received = new DecodedStream(head),
    sequence = received.decoder.elementDecoder.sequence!,
    whole = (): boolean[] =>
      Array.from({ length: sequence.timeline.numFrames }, (_, n) => sequence.frame(n, () => true, "motion").isWhole);
  for (const packet of packets.slice(1)) received.addPacket(packet);
  assert.deepEqual(new Set(whole()), new Set([false, true]));
  received.addPacket(packets[0]);
  assert.deepEqual(new Set(whole()), new Set([true]));
});

test("motion is decoded with the models of the newest head: those of a group that stands still are not fitted", () => {
  const { head, packets } = readStream("../tests/golden/tiny_clip.swz"),
    expected = new DecodedStream(head),
    received = new DecodedStream(head),
    decoder = received.decoder.elementDecoder as TrackDecoder,
    firstInfo = { ...decoder.info, models: decoder.info.models.map(() => 1 << 15) };
  Object.assign(decoder, { sequence: new Sequence(firstInfo, 0) });
  received.decoder.grow(head);
  for (const packet of packets) for (const stream of [expected, received]) stream.addPacket(packet);
  assert.deepEqual(framesOf(received), framesOf(expected));
});

test("the motion of a clip that replaced one with as many packets is shown", () => {
  const said: FromWorker[] = [],
    frames = new SequenceFrames((message) => said.push(message)),
    { head, packets } = readStream("../tests/golden/tiny_clip.swz");
  for (let clips = 0; clips < 2; clips++) {
    const received = new DecodedStream(head);
    for (const packet of packets) received.addPacket(packet);
    frames.frame({ kind: "frame", number: 2, simulation }, received, 1);
  }
  assert.deepEqual(
    said.map((one) => one.kind === "frame" && one.numConcealed),
    [0, 0],
  );
});
