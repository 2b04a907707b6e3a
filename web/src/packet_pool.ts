// Helper threads that decode packets, at most four, and fewer than the device has cores.

import type { FromHelper, HelpedPacket, PacketBody, ToHelper } from "./packet_helper.ts";

/** Largest number of helpers. */
const MAX_HELPERS = 4;
/** Minimum number of Gaussians at which helpers save more time than their start takes. */
const MIN_COUNT = 20_000;
/** Largest number of packets in a batch, and number of batches that a helper has at once. */
const MAX_BATCH = 8,
  QUEUED = 2;

/** The part of `Worker` that the pool uses. */
export interface HelperThread {
  onmessage: ((event: MessageEvent<FromHelper>) => void) | null;
  onerror: ((event: ErrorEvent) => void) | null;
  postMessage(message: ToHelper, transfer: ArrayBuffer[]): void;
  terminate(): void;
}

/** Packets of a batch that a helper decoded, and the time that it took, milliseconds. */
export interface DecodedBatch {
  /** Null for a packet that is decoded when it is drawn. */
  readonly packets: readonly (HelpedPacket | null)[];
  readonly ms: number;
}

type Resolve = (batch: DecodedBatch | null) => void;

interface Helper {
  readonly thread: HelperThread;
  readonly batches: Map<number, Resolve>;
  isReady: boolean;
}

interface Device {
  readonly hardwareConcurrency?: number;
  /** Memory of the device, GiB; absent if the browser keeps it secret. */
  readonly deviceMemory?: number;
}

/**
 * Returns the number of helpers for a stream of `count` Gaussians: at most one per GiB of memory. One core remains for
 * the page itself. A single helper would only replace the worker that starts it.
 */
export function numHelpers(count: number, { hardwareConcurrency = 1, deviceMemory = MAX_HELPERS }: Device): number {
  const most = Math.min(MAX_HELPERS, hardwareConcurrency - 1, Math.floor(deviceMemory));
  return count < MIN_COUNT || most < 2 ? 0 : most;
}

export class PacketPool {
  #helpers: Helper[] = [];
  #number = 0;

  /** Starts `count` helpers for the stream with this head. Threads that do not start are left out. */
  constructor(fileHead: Uint8Array, start: () => HelperThread, count: number) {
    for (let n = 0; n < count; n++) {
      try {
        this.#add(start(), fileHead);
      } catch {
        return; // the page's policy or the engine does not allow it
      }
    }
  }

  #add(thread: HelperThread, fileHead: Uint8Array): void {
    const helper: Helper = { thread, batches: new Map(), isReady: false };
    thread.onmessage = ({ data }) => this.#onMessage(helper, data);
    thread.onerror = () => this.#remove(helper);
    thread.postMessage({ kind: "help", fileHead }, []);
    this.#helpers.push(helper);
  }

  #onMessage(helper: Helper, message: FromHelper): void {
    helper.isReady = true;
    if (message.kind === "ready") return;
    const { number, packets, ms } = message,
      resolve = helper.batches.get(number);
    helper.batches.delete(number);
    resolve?.(packets && { packets, ms });
  }

  /** Ends a helper. Its batches resolve to null. */
  #remove(helper: Helper): void {
    this.#helpers = this.#helpers.filter((other) => other !== helper);
    helper.thread.terminate();
    for (const resolve of helper.batches.values()) resolve(null);
    helper.batches.clear();
  }

  /** Number of batches that helpers can have at once; 0 before the first helper is ready. */
  get capacity(): number {
    return QUEUED * this.#helpers.filter(({ isReady }) => isReady).length;
  }

  /** Returns the number of packets for the next batch, of `waiting` ones: few if few are waiting. */
  batchSize(waiting: number): number {
    return Math.max(Math.min(Math.ceil(waiting / Math.max(this.capacity, 1)), MAX_BATCH), 1);
  }

  /** Decodes packets in the least busy helper. Resolves to null if that failed. */
  decode(packets: readonly PacketBody[]): Promise<DecodedBatch | null> {
    const ready = this.#helpers.filter(({ isReady }) => isReady),
      helper = ready.sort((a, b) => a.batches.size - b.batches.size)[0];
    if (!helper) return Promise.resolve(null);
    const number = ++this.#number,
      bodies = packets.map(({ block, indexInBlock, count, payload }) => ({
        block,
        indexInBlock,
        count,
        payload: payload.slice(),
      }));
    return new Promise((resolve) => {
      helper.batches.set(number, resolve);
      helper.thread.postMessage(
        { kind: "batch", number, packets: bodies },
        bodies.map(({ payload }) => payload.buffer),
      );
    });
  }

  /** Ends all helpers. Their batches resolve to null. */
  close(): void {
    for (const helper of this.#helpers) this.#remove(helper);
  }
}
