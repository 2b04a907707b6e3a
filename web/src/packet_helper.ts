// Helper thread: decodes packets of one stream for the receiver's worker. Packets need only the side information.

import { StreamDecoder } from "./codec/decoder.ts";
import type { DecodedPacket, Schema } from "./codec/schema.ts";
import { HeadReader } from "./packets/container.ts";
import type { Packet } from "./packets/packet.ts";

/** Packet without its header, as decoders need it. */
export type PacketBody = Pick<Packet, "block" | "lane" | "count" | "payload">;

/** `help` starts a helper for the stream with this head. `batch` is answered by `decoded` with the same number. */
export type ToHelper =
  | { readonly kind: "help"; readonly file: Uint8Array }
  | { readonly kind: "batch"; readonly number: number; readonly packets: readonly PacketBody[] };

/**
 * `packets` is null if decoding failed, one of them if it is decoded when it is drawn. `ms` is the time that it took,
 * milliseconds.
 */
export type FromHelper =
  | { readonly kind: "ready" }
  | {
      readonly kind: "decoded";
      readonly number: number;
      readonly packets: readonly (DecodedPacket | null)[] | null;
      readonly ms: number;
    };

export class PacketHelper {
  #schema: Schema | null = null;

  constructor(readonly post: (message: FromHelper, hand: ArrayBuffer[]) => void) {}

  /** Handles a message of the receiver's worker. */
  receive(message: ToHelper): void {
    if (message.kind === "help") {
      const reader = new HeadReader();
      reader.feed(message.file);
      this.#schema = new StreamDecoder(reader.head!).schema;
      this.post({ kind: "ready" }, []);
      return;
    }
    const began = performance.now(),
      packets = this.#decode(message.packets),
      hand = (packets ?? []).flatMap((packet) => (packet ? buffersOfPacket(packet) : []));
    this.post({ kind: "decoded", number: message.number, packets, ms: performance.now() - began }, hand);
  }

  #decode(packets: readonly PacketBody[]): (DecodedPacket | null)[] | null {
    try {
      return packets.map((packet) => this.#schema!.decode!({ ...packet, bytes: packet.payload }));
    } catch {
      return null; // the receiver's worker decodes the batch itself and reports the error
    }
  }
}

/** Returns the buffers of a decoded packet, for transfer. */
function buffersOfPacket({ symbols, splats }: DecodedPacket): ArrayBuffer[] {
  const { means, quats, scales, opacities, colours, harmonics } = splats,
    // If there are integers, `rows` is one empty array that all packets share, which must not be transferred.
    all = [symbols.integers ?? symbols.rows, symbols.harmonics, means, quats, scales, opacities, colours, harmonics];
  return all.map(({ buffer }) => buffer as ArrayBuffer);
}
