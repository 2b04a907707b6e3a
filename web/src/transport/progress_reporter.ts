// Progress of a transfer over HTTP.

import type { Listener } from "./events.ts";
import type { PacketStore } from "./packet_store.ts";

const SINGLE_REQUEST = "HTTP, in order and without loss";

/** Reports bytes and packets to the listener. */
export class ProgressReporter {
  #bytes = 0;
  readonly #began = performance.now();

  constructor(
    readonly listener: Listener,
    readonly store: PacketStore,
    readonly transport = SINGLE_REQUEST,
  ) {}

  add(bytes: number): void {
    this.#bytes += bytes;
    this.listener.counts({
      transport: this.transport,
      bytes: this.#bytes,
      packets: this.store.count,
      expected: this.store.head?.manifest.numPackets ?? 0,
      lost: 0,
      rejected: 0,
      seconds: (performance.now() - this.#began) / 1000,
    });
  }
}
