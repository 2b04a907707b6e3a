// The worker: receives, decodes and conceals, so that the page never waits for it.

import { BitstreamError } from "./bytes.ts";
import { Reception, say } from "./reception.ts";
import type { ToWorker } from "./transport/messages.ts";
import { Refused, receiveBytes, receiveFile } from "./transport/reliable.ts";
import { retrying, waitOrOnline } from "./transport/retry.ts";
import { askServer, receiveDatagrams, type Session } from "./transport/webtransport.ts";
import { warmUp } from "./warm.ts";

const reception = new Reception();

/**
 * A page may be older than its server's certificate: where no session comes about, the server is asked for the hash of
 * today.
 */
async function receiveSession(session: Session, name: string, file: string): Promise<string> {
  try {
    return await receiveDatagrams(session, name, reception);
  } catch (error) {
    const now = session.fingerprint && !reception.begun ? await askServer(new URL(file)) : null;
    if (!now?.fingerprint || now.fingerprint === session.fingerprint) throw error;
    return receiveDatagrams({ ...session, fingerprint: now.fingerprint }, name, reception);
  }
}

/** One attempt: a session sends everything, so that of what began before the rest comes out of the file. */
async function attempt(session: Session | null, name: string, file: string): Promise<string> {
  if (session && !reception.held.begun) {
    let ended: string;
    try {
      ended = await receiveSession(session, name, file);
      if (["complete", "sent", "stopped"].includes(ended)) return ended;
    } catch (error) {
      ended = (error as Error).message;
    }
    say({ kind: "note", text: `${reception.begun ? "The rest comes" : "The stream comes"} by HTTP: ${ended}.` });
  }
  return receiveFile(file, reception, reception.held, reception.headOfHeld);
}

async function open({ session, name, file, bytes }: ToWorker & { kind: "open" }): Promise<string> {
  if (bytes) return receiveBytes(bytes, reception);
  void warmUp(() => !reception.begun);
  await reception.resume(file);
  return retrying(() => attempt(session, name, file), {
    helps: (error) => !(error instanceof BitstreamError || (error instanceof Refused && error.final)),
    progress: () => reception.held.count,
    lost: (reason, retryMs) => void reception.settled().then(() => say({ kind: "lost", reason, retryMs })),
    wait: waitOrOnline,
  });
}

self.addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  if (data.kind === "conceal") return void reception.conceal(data);
  if (data.kind === "look") return reception.look(data);
  if (data.kind === "digest") return void reception.digest();
  open(data).then(
    async (text) => {
      await reception.settled();
      const complete = text === "complete" && reception.complete;
      say({ kind: "finished", text, complete });
      if (complete) void reception.digest();
    },
    async (error: unknown) => {
      await reception.settled();
      say({ kind: "failed", text: (error as Error).message });
    },
  );
});
