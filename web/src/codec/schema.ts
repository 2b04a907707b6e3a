// What a schema of elements has to know; which one a stream has is asked in `decoder.ts` and nowhere else.

import type { Concealer } from "../conceal/conceal.ts";
import type { Elements } from "../conceal/elements.ts";
import type { Packet } from "../packets/packet.ts";
import type { Plan } from "../packets/plan.ts";
import type { Pause } from "../turns.ts";
import type { Tiling } from "./levels/tiling.ts";
import type { Copies, Part } from "./part.ts";
import type { Splats } from "./splats.ts";

/** What moves: its frames, as far as packets of them came. */
export interface Moving {
  /** Frames a second, how many there are, and how many a group has. */
  readonly times: { readonly rate: number; readonly numFrames: number; readonly groupFrames: number };
  /** The names of what hides lost motion. */
  readonly concealers: readonly string[];
  /** A frame; packets that are not shown count as lost. */
  frame(number: number, shown: (packet: Packet) => boolean, concealer: string): MovingFrame;
  /** Makes ready what comes after a frame, for so many milliseconds. */
  ahead(number: number, ms: number): void;
  /** Packets of motion that came and were not forgotten. */
  readonly packets: readonly Packet[];
  /** Number of the first frame, of a clip that goes on where another one ended. */
  readonly firstFrame: number;
  /** Frames of groups that nothing more is awaited of: they are whole, or another one has begun. */
  readonly ready: number;
  /** Packets of motion that came after their group was shown. */
  readonly late: number;
  /** Forgets what packets say of groups before that of a frame, which are not shown again; their blocks. */
  forget(number: number): number[];
}

export interface MovingFrame {
  readonly number: number;
  readonly splats: Splats;
  /** Of how many elements the motion is a guess. */
  readonly concealed: number;
}

export interface Schema<P extends Part = Part> {
  /** Whether another camera sees other Gaussians. */
  readonly viewDependent: boolean;
  /** Degree of the Gaussians' harmonics. */
  readonly degree: number;
  /** Size of the scene, world units. */
  readonly size: number;
  /** Middle of the scene, where it is known before any element. */
  readonly middle: readonly number[] | null;
  readonly sections: Map<string, Uint8Array>;
  /** What is drawn in place of the elements; null where they stand still. */
  readonly moving: Moving | null;
  /** What is drawn of a scene with levels, and what is to be fetched of it; null of every other. */
  readonly tiling: Tiling | null;
  /** By name, what hides losses of such elements. */
  readonly concealers: Readonly<Record<string, Concealer>>;
  /** Memory that an element takes where a concealer looks at all of them, lost ones, too. */
  readonly lookedAtBytes: number;
  /** Memory that is held of a packet's elements once they are decoded. */
  bytesOf(packet: Packet): number;
  /** Goes on with the head of the same stream that has grown; none where streams do not grow. */
  grow?(sideInfo: Uint8Array, plan: Plan): void;
  /** Decodes a packet that fits the plan; any payload gives something. */
  read(packet: Packet): P;
  /** Digest of all decoded integers, given the packets of each block in order. */
  digest(blocks: readonly (readonly Packet[])[], pause: Pause): Promise<string>;
  /**
   * What the concealer `sketch` draws, of streams that offer it; null where nobody waits any more. Throws where it is
   * damaged.
   */
  copies(pause: Pause): Promise<Copies<P> | null>;
  /**
   * What is known of all elements: first those of the given parts, in order, then the lost ones; null where nobody
   * waits any more.
   */
  elements(parts: readonly P[], pause: Pause): Promise<Elements | null>;
}
