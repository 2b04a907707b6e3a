// Messages of a server, for tests.

import { crc32 } from "../src/packets/crc32.ts";
import { dataView } from "../src/transport/wire_messages.ts";

/** Appends the checksum of a message. */
function sealed(bytes: Uint8Array): Uint8Array {
  const all = new Uint8Array(bytes.length + 4);
  all.set(bytes);
  dataView(all).setUint32(bytes.length, crc32(bytes), true);
  return all;
}

/** Returns a welcome message with one tier, for nonce 7. */
export function welcome(change: (view: DataView, bytes: Uint8Array) => void = () => undefined): Uint8Array {
  const bytes = new Uint8Array(71 + 8 + 2 + 3),
    view = dataView(bytes);
  bytes[0] = 0x44;
  view.setBigUint64(1, 7n, true);
  view.setUint32(9, 2, true);
  view.setUint32(13, 3, true);
  view.setBigUint64(17, 400n, true);
  view.setUint16(57, 256, true);
  view.setUint32(59, 10, true);
  view.setUint16(63, 1150, true);
  bytes[70] = 1;
  view.setUint16(79, 3, true);
  change(view, bytes);
  return sealed(bytes);
}

/** A datagram with an empty packet, of a block of its own unless one is given, for a position of the sending order. */
export function empty(place: number, block = place): Uint8Array {
  const packet = new Uint8Array(24),
    view = dataView(packet);
  packet[0] = 1;
  view.setUint32(1, 3, true);
  view.setUint16(7, block, true);
  view.setUint16(10, 1, true);
  view.setUint32(12, crc32(packet.subarray(16), crc32(packet.subarray(0, 12))), true);
  const datagram = new Uint8Array(13 + packet.length);
  datagram[0] = 0x46;
  dataView(datagram).setUint32(1, 2, true);
  dataView(datagram).setUint32(9, place, true);
  datagram.set(packet, 13);
  return datagram;
}
