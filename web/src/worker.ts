// Entry point of the worker: receives, decodes and conceals without blocking the page. Its helpers, which only decode,
// run the same script.

import { warmUp } from "./jit_warmup.ts";
import { PacketHelper, type ToHelper } from "./packet_helper.ts";
import { receiveAll } from "./transport/failover.ts";
import { receiveBytes } from "./transport/http_source.ts";
import type { ToWorker } from "./transport/messages.ts";
import { post, WorkerReceiver } from "./worker_receiver.ts";

const reception = new WorkerReceiver(),
  helper = new PacketHelper((message, transfer) => self.postMessage(message, { transfer }));

async function open({ bytes, ...source }: ToWorker & { kind: "open" }): Promise<string> {
  if (bytes) return receiveBytes(bytes, reception, reception.store);
  void warmUp(() => !reception.begun);
  await reception.resume(source.file);
  return receiveAll(source, reception);
}

const fail = (error: unknown): void => post({ kind: "failed", text: (error as Error)?.message ?? String(error) });

// browsers report an error of an asynchronous function nowhere, and the page would wait without end
self.addEventListener("unhandledrejection", ({ reason }) => fail(reason));

self.addEventListener("message", ({ data }: MessageEvent<ToWorker | ToHelper>) => {
  if (data.kind === "help" || data.kind === "batch") return helper.receive(data);
  if (data.kind === "conceal") return void reception.conceal(data);
  if (data.kind === "frame") return reception.frame(data);
  if (data.kind === "view") return reception.setView(data);
  if (data.kind === "digest") return void reception.digest();
  if (data.kind === "follow") return void reception.follow(data.file);
  if (SEPARATE && self.name !== BUILD) return fail("splatwire-worker.js has another version than the page: reload it");
  open(data).then(
    async (outcome) => {
      await reception.settled();
      if (reception.failed) return post({ kind: "failed", text: reception.failed.message });
      const complete = outcome === "complete" && reception.complete && !reception.live;
      if (complete) reception.cancelConcealment();
      post({ kind: "finished", outcome, complete });
      if (complete) void reception.digest();
    },
    async (error: unknown) => {
      await reception.settled();
      fail(error);
    },
  );
});
