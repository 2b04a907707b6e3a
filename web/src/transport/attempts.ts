// The ways to a stream, one after another, again and again until everything came that is to be had.

import { BitstreamError } from "../bytes.ts";
import type { Head } from "../packets/container.ts";
import type { Listener } from "./events.ts";
import type { Held } from "./held.ts";
import { Refused } from "./refused.ts";
import { receiveFile } from "./reliable.ts";
import { retrying, waitOrOnline } from "./retry.ts";
import { askServer, receiveDatagrams, type Session } from "./webtransport.ts";

/** Where a stream is to be had. */
export interface Source {
  readonly session: Session | null;
  readonly name: string;
  readonly file: string;
}

/** Who receives: besides what a way tells, what is there, and what came in between. */
export interface Receiver extends Listener {
  readonly held: Held;
  /** The head of the file of which a part is there. */
  readonly headOfHeld: Head | null;
  /** Whether it is a live clip, of which there is no file. */
  readonly live: boolean;
  note(text: string): void;
  lost(reason: string, retryMs: number): void;
}

/** Receives until the end; gives the words for how it ended. Throws what trying again could not change. */
export function receiveAll(source: Source, receiver: Receiver): Promise<string> {
  return retrying(() => attempt(source, receiver), {
    helps: (error) =>
      !receiver.stopped() && !(error instanceof BitstreamError || (error instanceof Refused && error.final)),
    progress: () => receiver.held.count,
    lost: (reason, retryMs) => receiver.lost(reason, retryMs),
    wait: waitOrOnline,
  });
}

/**
 * One attempt: what is lacking comes over a session or, where none comes about, out of the file. A session that breaks
 * after it brought something is tried again.
 */
async function attempt({ session, name, file }: Source, receiver: Receiver): Promise<string> {
  const { count } = receiver.held;
  if (session && (!count || count !== receiver.headOfHeld?.manifest.numPackets)) {
    let ended: string;
    try {
      ended = await receiveSession(session, name, file, receiver);
      if (["complete", "sent", "stopped"].includes(ended)) return ended;
    } catch (error) {
      ended = (error as Error).message;
    }
    if (receiver.live || receiver.held.count > count) throw new Error(ended);
    receiver.note(`${receiver.held.begun ? "The rest comes" : "The stream comes"} by HTTP: ${ended}.`);
  }
  return receiveFile(file, receiver, receiver.held, receiver.headOfHeld);
}

/**
 * A page may be older than its server's certificate: where no session comes about, the server is asked for the hash of
 * today.
 */
async function receiveSession(session: Session, name: string, file: string, receiver: Receiver): Promise<string> {
  const { held, headOfHeld: head } = receiver,
    begin = (where: Session): Promise<string> =>
      receiveDatagrams(where, name, receiver, head && { head, held: held.bits }, () => held.clear());
  try {
    return await begin(session);
  } catch (error) {
    const now = session.fingerprint ? await askServer(new URL(file)) : null;
    if (!now?.fingerprint || now.fingerprint === session.fingerprint) throw error;
    return begin({ ...session, fingerprint: now.fingerprint });
  }
}

/** The source that an address names: its server may say beside the file where it sends datagrams. */
export async function sourceOf(file: URL, given: Session | null): Promise<Source> {
  const name = decodeURIComponent(file.pathname.split("/").pop() ?? "").replace(/\.swz$/, "");
  return { session: given ?? (await askServer(file)), name, file: file.href };
}
