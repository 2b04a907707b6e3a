// Interface of the kinds of elements. Only `decoder.ts` chooses the kind of a stream.

import type { Concealer } from "../conceal/conceal.ts";
import type { Elements } from "../conceal/elements.ts";
import type { Packet } from "../packets/packet.ts";
import type { Plan } from "../packets/plan.ts";
import type { Pause } from "../scheduler.ts";
import type { Copies, ElementBatch } from "./element_batch.ts";
import type { Decoded } from "./gaussians/packet.ts";
import type { Tiling } from "./levels/tiling.ts";
import type { Splats } from "./splats.ts";

/**
 * Frames of a moving scene, as far as their packets were received. Frames are counted from 0 in this stream, which is
 * one period of a live clip. Messages, `Playable` and players count from the first frame of the clip, of which this
 * stream begins with number `firstFrame`.
 */
export interface SequenceDecoder {
  /** Frames per second, number of frames, and frames per group of pictures. */
  readonly timeline: { readonly rate: number; readonly numFrames: number; readonly groupFrames: number };
  /** Names of the concealers for lost motion packets. */
  readonly concealers: readonly string[];
  /**
   * Returns a frame. A packet counts as lost if `isReceived` returns false. With `reuse`, its Gaussians are valid
   * until the next call.
   */
  frame(number: number, isReceived: (packet: Packet) => boolean, concealer: string, reuse?: boolean): DecodedFrame;
  /** Decodes motion of the group after that of frame `number` in advance, for up to `ms` milliseconds. */
  prefetch(number: number, ms: number): void;
  /** Received motion packets with payloads still in memory. */
  readonly packets: readonly Packet[];
  /** Number in the whole clip of this stream's first frame; not 0 if it continues an earlier stream. */
  readonly firstFrame: number;
  /** End of the playable frames. A group is playable once it is complete or the head announces a later one. */
  readonly playableEnd: number;
  /** Number of motion packets that arrived after their group was shown. */
  readonly numLatePackets: number;
  /**
   * Releases the motion packets of all groups before that of a frame. Returns their blocks and those of packets that
   * arrived late. Those groups cannot be shown again. Keyframe Gaussians stay.
   */
  forgetMotion(number: number): number[];
}

export interface DecodedFrame {
  /** Number in this stream, as in `SequenceDecoder.frame`. */
  readonly number: number;
  readonly splats: Splats;
  /** Number of tracks with estimated motion. */
  readonly numConcealed: number;
  /** True if all packets of its group have arrived. */
  readonly isWhole: boolean;
}

/** Decoded packet of explicit Gaussians: its integers, and the Gaussians made of them. */
export interface DecodedPacket {
  readonly symbols: Decoded;
  readonly splats: Splats;
}

/** Decoder of the elements of one stream. */
export interface ElementDecoder<P extends ElementBatch = ElementBatch> {
  /** True if the Gaussians depend on the camera. */
  readonly viewDependent: boolean;
  /** Degree of the spherical harmonics. */
  readonly degree: number;
  /** Size of the scene, world units. */
  readonly size: number;
  /** Centre of the scene, world units; null if it is unknown before the first packet. */
  readonly middle: readonly number[] | null;
  /**
   * Number of first blocks whose Gaussians determine the default viewpoint: the coarsest tiles, or the first group of
   * frames that has any. Absent if all Gaussians determine it.
   */
  readonly framingBlocks?: number;
  readonly sections: Map<string, Uint8Array>;
  /** Frames of a moving scene; null for static scenes. */
  readonly sequence: SequenceDecoder | null;
  /** Tiles of a scene with levels; null for other scenes. */
  readonly tiling: Tiling | null;
  /** Concealers for this kind of elements, by name. */
  readonly concealers: Readonly<Record<string, Concealer>>;
  /** Memory of concealment per element, received or lost, bytes. */
  readonly concealmentBytes: number;
  /** Returns the memory of a packet's decoded elements, bytes. */
  bytesOf(packet: Packet): number;
  /** Continues with a longer head of the same stream. Absent if streams of this kind do not grow. */
  grow?(sideInfo: Uint8Array, plan: Plan): void;
  /** Adds a packet that fits the plan, and decodes it unless such packets are decoded only for drawing. */
  read(packet: Packet): P;
  /**
   * Decodes a packet without changing this object, so that another thread can do it. Returns null for packets that are
   * decoded only for drawing, such as those with motion. Absent if that is true for all packets of the kind of stream.
   */
  decode?(packet: Packet): DecodedPacket | null;
  /** Adds a packet that `decode` decoded, here or in another thread. Replaces `read`. */
  accept?(packet: Packet, decoded: DecodedPacket): P;
  /** Returns the digest of all decoded integers, given the packets of each block in order. */
  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string>;
  /**
   * Returns the redundant copies that the concealer `sketch` draws. Resolves to null if the stream has none or the
   * result is no longer needed. Throws `BitstreamError` for damaged copies.
   */
  copies(pause: Pause): Promise<Copies<P> | null>;
  /**
   * Returns the properties of all elements: those of the given batches in order, then the lost ones. Resolves to null
   * if the result is no longer needed.
   */
  elements(batches: readonly P[], pause: Pause): Promise<Elements | null>;
}
