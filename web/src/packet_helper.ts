// Helper thread: decodes packets of one stream for the receiver's worker. Packets need only the side information.

import { StreamDecoder } from "./codec/decoder.ts";
import type { DecodedPacket, ElementDecoder } from "./codec/element_decoder.ts";
import { HeadReader } from "./packets/container.ts";
import type { Packet } from "./packets/packet.ts";
import { bufferOf, type Packed, pack } from "./render/packed.ts";

/** Packet without its header, as decoders need it. */
export type PacketBody = Pick<Packet, "block" | "indexInBlock" | "count" | "payload">;

/** Decoded packet, with its Gaussians packed for the GPU; `packed` is null in clips, whose Gaussians move. */
export interface HelpedPacket extends DecodedPacket {
  readonly packed: Packed | null;
}

/** `help` starts a helper for the stream with this head. `batch` is answered by `decoded` with the same number. */
export type ToHelper =
  | { readonly kind: "help"; readonly fileHead: Uint8Array }
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
      readonly packets: readonly (HelpedPacket | null)[] | null;
      readonly ms: number;
    };

export class PacketHelper {
  #elementDecoder: ElementDecoder | null = null;

  constructor(readonly post: (message: FromHelper, hand: ArrayBuffer[]) => void) {}

  /** Handles a message of the receiver's worker. */
  receive(message: ToHelper): void {
    if (message.kind === "help") {
      const reader = new HeadReader();
      reader.feed(message.fileHead);
      this.#elementDecoder = new StreamDecoder(reader.head!).elementDecoder;
      this.post({ kind: "ready" }, []);
      return;
    }
    const began = performance.now(),
      packets = this.#decode(message.packets),
      hand = (packets ?? []).flatMap((packet) => (packet ? buffersOfPacket(packet) : []));
    this.post({ kind: "decoded", number: message.number, packets, ms: performance.now() - began }, hand);
  }

  #decode(packets: readonly PacketBody[]): (HelpedPacket | null)[] | null {
    const { degree, size, sequence } = this.#elementDecoder!;
    try {
      return packets.map((packet) => {
        const decoded = this.#elementDecoder!.decode!({ ...packet, bytes: packet.payload });
        return decoded && { ...decoded, packed: sequence ? null : pack([decoded.splats], degree, size) };
      });
    } catch {
      return null; // the receiver's worker decodes the batch itself and reports the error
    }
  }
}

/** Returns the buffers of a decoded packet, for transfer. */
function buffersOfPacket({ symbols, splats, packed }: HelpedPacket): ArrayBuffer[] {
  // If there are integers, `rows` is one empty array that all packets share, which must not be transferred.
  const { rows, integers = rows, harmonics } = symbols,
    buffers = [integers, harmonics, splats.means].map(({ buffer }) => buffer as ArrayBuffer);
  return [...new Set([...buffers, ...(packed ? [bufferOf(packed)] : [])])]; // arrays share buffers
}
