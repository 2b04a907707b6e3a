// The ways to a stream, one after another, again and again until everything came that is to be had.

import { BitstreamError } from "../bytes.ts";
import type { Listener } from "./events.ts";
import type { Held } from "./held.ts";
import { HttpFile } from "./http_file.ts";
import { Refused } from "./refused.ts";
import { receiveFile } from "./reliable.ts";
import { retrying, waitOrOnline } from "./retry.ts";
import { FINAL_REFUSALS } from "./transfer.ts";
import { askServer, NoWebTransport, receiveDatagrams, type Session } from "./webtransport.ts";

/** How often a file is requested again that the server has given before and refuses now. */
const MAX_REFUSALS = 4;

/** Where a stream is to be had. */
export interface Source {
  readonly session: Session | null;
  readonly name: string;
  readonly file: string;
}

/** Listener with the held packets and the state of the link. */
export interface Receiver extends Listener {
  readonly held: Held;
  /** Whether it is a live clip, of which there is no file. */
  readonly live: boolean;
  note(text: string): void;
  lost(reason: string, retryMs: number): void;
}

/** Ways to a stream that can be replaced in tests. */
export interface Ways {
  readonly receiveDatagrams: typeof receiveDatagrams;
  readonly askServer: typeof askServer;
  readonly wait: (ms: number) => Promise<void>;
  readonly openFile: (url: string) => HttpFile;
}

const WAYS: Ways = { receiveDatagrams, askServer, wait: waitOrOnline, openFile: (url) => new HttpFile(url) };

/** Receives until the end; gives the words for how it ended. Throws what trying again could not change. */
export function receiveAll(source: Source, receiver: Receiver, ways = WAYS): Promise<string> {
  const attempts = new Attempts(source, receiver, ways);
  return retrying(() => attempts.attempt(), {
    helps: (error) => !receiver.stopped() && attempts.helps(error),
    progress: () => receiver.held.count,
    lost: (reason, retryMs) => receiver.lost(reason, retryMs),
    wait: ways.wait,
  });
}

class Attempts {
  readonly #file: HttpFile;
  #session: Session | null;

  constructor(
    readonly source: Source,
    readonly receiver: Receiver,
    readonly ways: Ways,
  ) {
    this.#file = ways.openFile(source.file);
    this.#session = source.session;
  }

  helps(error: unknown): boolean {
    if (error instanceof BitstreamError) return false;
    // a file that was given before may be in the middle of its replacement
    return !(error instanceof Refused && error.final) || (this.#file.given && ++this.#file.refusals <= MAX_REFUSALS);
  }

  /**
   * Makes one attempt: missing packets come over a session or, without one, out of the file. A session that breaks
   * after it brought packets is tried again.
   */
  async attempt(): Promise<string> {
    const { receiver } = this,
      { held } = receiver,
      { count } = held,
      begun = this.#session !== null && !held.complete;
    let broken: unknown = null;
    if (begun) {
      try {
        return await this.#receiveSession(this.#session!);
      } catch (error) {
        broken = error;
      }
      const reason = (broken as Error).message;
      if (receiver.live || held.count > count) throw broken;
      receiver.note(`${held.begun ? "The rest comes" : "The stream comes"} by HTTP: ${reason}.`);
    }
    try {
      return await receiveFile(this.#file, receiver, held);
    } catch (error) {
      if (!(error instanceof Refused && error.final)) throw error;
      return this.#withoutFile(error, begun, broken as Error | null);
    }
  }

  /**
   * Continues without a file: a live clip comes over sessions only. A session that failed because of the link is tried
   * again, and a visitor gets its reason.
   */
  async #withoutFile(refused: Refused, begun: boolean, broken: Error | null): Promise<string> {
    if (broken && !(broken instanceof NoWebTransport) && !FINAL_REFUSALS.includes(broken.message))
      throw new Error(`${broken.message}; and ${refused.message}`);
    if (broken instanceof NoWebTransport) refused.message += `, and ${broken.message}`;
    if (begun) throw refused;
    // The server may not have been reachable when it was asked for its sessions.
    this.#session ??= await this.ways.askServer(new URL(this.source.file));
    if (!this.#session) throw refused;
    return this.#receiveSession(this.#session);
  }

  /**
   * A page may be older than its server's certificate: where no session comes about, the server is asked for the hash
   * of today. Throws unless the session ends as it should.
   */
  async #receiveSession(session: Session): Promise<string> {
    const { receiver, source } = this,
      begin = async (where: Session): Promise<string> => {
        const { held } = receiver,
          before = held.head && { head: held.head, held: held.bits },
          ended = await this.ways.receiveDatagrams(where, source.name, receiver, before);
        if (!["complete", "sent", "stopped"].includes(ended)) throw new Error(ended);
        return ended;
      };
    try {
      return await begin(session);
    } catch (error) {
      if (receiver.live || !session.fingerprint || error instanceof NoWebTransport) throw error;
      const now = await this.ways.askServer(new URL(source.file));
      if (!now?.fingerprint || now.fingerprint === session.fingerprint) throw error;
      this.#session = { ...session, fingerprint: now.fingerprint };
      return begin(this.#session);
    }
  }
}

/** The source that an address names: its server may say beside the file where it sends datagrams. */
export async function sourceOf(file: URL, given: Session | null): Promise<Source> {
  const last = file.pathname.split("/").pop() ?? "";
  return { session: given ?? (await askServer(file)), name: decoded(last).replace(/\.swz$/, ""), file: file.href };
}

function decoded(name: string): string {
  try {
    return decodeURIComponent(name);
  } catch {
    return name; // a percent sign that is meant as one
  }
}
