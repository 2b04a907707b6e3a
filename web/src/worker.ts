// The worker: receives, decodes and conceals, so that the page never waits for it.

import { Reception, say } from "./reception.ts";
import { receiveAll } from "./transport/attempts.ts";
import type { ToWorker } from "./transport/messages.ts";
import { receiveBytes } from "./transport/reliable.ts";
import { warmUp } from "./warm.ts";

const reception = new Reception();

async function open({ bytes, ...source }: ToWorker & { kind: "open" }): Promise<string> {
  if (bytes) return receiveBytes(bytes, reception, reception.held);
  void warmUp(() => !reception.begun);
  await reception.resume(source.file);
  return receiveAll(source, reception);
}

self.addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  if (data.kind === "conceal") return void reception.conceal(data);
  if (data.kind === "frame") return reception.frame(data);
  if (data.kind === "look") return reception.look(data);
  if (data.kind === "digest") return void reception.digest();
  open(data).then(
    async (text) => {
      await reception.settled();
      if (reception.failed) return say({ kind: "failed", text: reception.failed.message });
      const complete = text === "complete" && reception.complete && !reception.live;
      say({ kind: "finished", text, complete });
      if (complete) void reception.digest();
    },
    async (error: unknown) => {
      await reception.settled();
      say({ kind: "failed", text: (error as Error).message });
    },
  );
});
