// Failover between the sources of a stream, with retries, until all available packets are received.

import { BitstreamError } from "../bytes.ts";
import { waitOrOnline, withBackoff } from "./backoff.ts";
import type { Listener } from "./events.ts";
import { isFinal } from "./http_error.ts";
import { HttpFile } from "./http_file.ts";
import { receiveFile } from "./http_source.ts";
import type { PacketStore } from "./packet_store.ts";
import { FINAL_REFUSALS } from "./transfer.ts";
import { lookUpSession, receiveDatagrams, type SessionAddress, TOO_SLOW } from "./webtransport.ts";

/** Largest number of attempts with a file that the server delivered before, and refuses or damages now. */
const MAX_REFUSALS = 4;
/** Largest number of sessions that end as complete although packets are missing. */
const MAX_INCOMPLETE = 3;
/** Number of sessions in a row without a packet, or too slow, after which the file of a live clip is requested, too. */
const MAX_EMPTY_SESSIONS = 2;

/**
 * Time for the first answer of a file, after which the session that failed before is opened again, as a multiple of the
 * delay before the next attempt. It grows, because a slow link may need several round trips of seconds.
 */
const ANSWER_DELAYS = 8;

/** Returns true if no further session can succeed after one that ended with this error. */
const isHopeless = (broken: Error): boolean => isFinal(broken) || FINAL_REFUSALS.includes(broken.message);

/** Sources of a stream: WebTransport session and file. */
export interface Source {
  readonly session: SessionAddress | null;
  readonly name: string;
  readonly file: string;
}

/** Listener with the received packets and the state of the connection. */
export interface Receiver extends Listener {
  readonly store: PacketStore;
  /** True for live clips. They have no file while they run; a server may later offer a file under the same name. */
  readonly live: boolean;
  /** Number of received packets of this visit. It never decreases. */
  readonly numReceived: number;
  note(text: string): void;
  disconnected(reason: string, retryMs: number): void;
}

/** Transports, replaceable in tests. */
export interface Transports {
  readonly receiveDatagrams: typeof receiveDatagrams;
  readonly lookUpSession: typeof lookUpSession;
  readonly wait: (ms: number) => Promise<void>;
  readonly openFile: (url: string) => HttpFile;
}

const TRANSPORTS: Transports = {
  receiveDatagrams,
  lookUpSession,
  wait: waitOrOnline,
  openFile: (url) => new HttpFile(url),
};

/**
 * Receives a stream and returns how it ended: `complete`, `sent`, `stopped` or a reason. After `sent`, packets may be
 * missing although the server sent all. Throws errors that a retry cannot resolve.
 */
export function receiveAll(source: Source, receiver: Receiver, transports = TRANSPORTS): Promise<string> {
  const failover = new Failover(source, receiver, transports);
  return withBackoff((nextMs) => failover.attempt(nextMs), {
    isRetryable: (error) => !receiver.stopped() && failover.canRetry(error),
    progress: () => receiver.numReceived + failover.numBegun,
    disconnected: (reason, retryMs) => receiver.disconnected(reason, retryMs),
    wait: transports.wait,
  });
}

class Failover {
  readonly #file: HttpFile;
  #address: SessionAddress | null;
  #numIncomplete = 0;
  #numSessions = 0;
  /** Number of sessions in a row without a packet, or too slow (`TOO_SLOW`). */
  #numEmpty = 0;
  /** True once the server has refused the file, as for live clips. */
  #isWithoutFile = false;

  constructor(
    readonly source: Source,
    readonly receiver: Receiver,
    readonly transports: Transports,
  ) {
    this.#file = transports.openFile(source.file);
    this.#address = source.session;
  }

  /** Progress that is not counted in packets, see `HttpFile.numBegun`. */
  get numBegun(): number {
    return this.#file.numBegun;
  }

  /** Returns true if another attempt may succeed. Counts the refusals of a file that was delivered before. */
  canRetry(error: unknown): boolean {
    const isDamaged = error instanceof BitstreamError;
    if (!isDamaged && !isFinal(error)) return true;
    // a file that was delivered before, or ends too early, may be in the middle of its replacement
    const isKnown = isDamaged ? this.receiver.store.hasHead || this.#file.isCut : this.#file.hasAnswered;
    return isKnown && ++this.#file.refusals <= MAX_REFUSALS;
  }

  /**
   * Makes one attempt: missing packets are received over a session or, without one, from the file. A session that
   * breaks after delivering packets is retried, and so is the first one of a live clip that delivers none. The file of
   * a live clip has `nextMs` milliseconds to arrive, after which the next session is due; other files have
   * `ANSWER_DELAYS` times as long for their first answer.
   */
  async attempt(nextMs: number): Promise<string> {
    const { receiver } = this,
      { store, numReceived } = receiver,
      triesSession = this.#address !== null && !store.complete;
    let broken: Error | null = null;
    if (triesSession) {
      try {
        return await this.#receiveSession(this.#address!);
      } catch (error) {
        broken = error as Error;
      }
      const hasHelped = receiver.numReceived > numReceived && broken.message !== TOO_SLOW;
      this.#numEmpty = hasHelped ? 0 : this.#numEmpty + 1;
      if (this.#numEmpty < (receiver.live ? MAX_EMPTY_SESSIONS : 1)) throw broken;
      receiver.note(`${store.hasHead ? "The rest comes" : "The stream comes"} by HTTP: ${broken.message}.`);
    }
    const due = new AbortController(),
      isDue = (): boolean => receiver.live || !(this.#file.hasAnswered || isHopeless(broken!)),
      timer = setTimeout(() => broken && isDue() && due.abort(), receiver.live ? nextMs : ANSWER_DELAYS * nextMs);
    this.#file.signal = due.signal;
    try {
      return await receiveFile(this.#file, receiver, store);
    } catch (error) {
      // the session of a live clip may return at any time; the file of another scene did not answer in time
      if (broken && (receiver.live || due.signal.aborted)) {
        const waited = due.signal.aborted,
          reason = waited ? "the file did not arrive in time" : (error as Error).message;
        throw Object.assign(new Error(`${broken.message}; and ${reason}`), { waited });
      }
      if (!isFinal(error)) throw error;
      return this.#withoutFile(error as Error, triesSession, broken);
    } finally {
      clearTimeout(timer);
    }
  }

  /**
   * Continues without a file, as for live clips. A session that failed because of the connection is retried, and its
   * reason is reported.
   */
  async #withoutFile(refused: Error, triedSession: boolean, broken: Error | null): Promise<string> {
    this.#isWithoutFile = true;
    if (broken && !isHopeless(broken)) throw new Error(`${broken.message}; and ${refused.message}`);
    if (isFinal(broken)) refused.message += `, and ${broken!.message}`;
    if (triedSession) throw refused;
    // The server may have been unreachable when its session was looked up.
    this.#address ??= await this.transports.lookUpSession(new URL(this.source.file));
    if (!this.#address) throw refused;
    return this.#receiveSession(this.#address);
  }

  /**
   * Receives over a session. A server that was restarted has another self-signed certificate, which is looked up:
   * before another attempt at a live clip, otherwise after a failure. Throws unless the session ends normally.
   */
  async #receiveSession(address: SessionAddress): Promise<string> {
    const { receiver } = this;
    if (receiver.live && address.fingerprint) return this.#receiveOnce((await this.#renewed(address)) ?? address);
    try {
      return await this.#receiveOnce(address);
    } catch (error) {
      if (receiver.live || !address.fingerprint || isFinal(error)) throw error;
      const renewed = await this.#renewed(address);
      if (!renewed) throw error;
      return this.#receiveOnce(renewed);
    }
  }

  async #receiveOnce(address: SessionAddress): Promise<string> {
    const { receiver, source } = this,
      { store } = receiver,
      before = store.head && {
        head: store.head,
        initSegment: store.initSegment,
        bitsOf: (orderDigest: string): Uint8Array | null => store.bitsOf(orderDigest),
      },
      options = { isRetry: this.#numSessions++ > 0, isOnlySource: receiver.live || this.#isWithoutFile },
      outcome = await this.transports.receiveDatagrams(address, source.name, receiver, before, options);
    if (!["complete", "sent", "stopped"].includes(outcome)) throw new Error(outcome);
    const isIncomplete = outcome === "complete" && !receiver.live && store.hasHead && !store.complete;
    if (isIncomplete && ++this.#numIncomplete <= MAX_INCOMPLETE)
      throw new Error("the session ended without all packets");
    return isIncomplete ? "sent" : outcome;
  }

  /**
   * Returns the address that the server publishes if its certificate differs from that of the address in use, else
   * null. An address on another host than the file keeps its URL.
   */
  async #renewed(address: SessionAddress): Promise<SessionAddress | null> {
    const published = await this.transports.lookUpSession(new URL(this.source.file)),
      fingerprint = published?.fingerprint;
    if (!published || !fingerprint || fingerprint === address.fingerprint) return null;
    const isSameHost = new URL(published.url).hostname === new URL(address.url).hostname;
    return (this.#address = isSameHost ? published : { ...address, fingerprint });
  }
}

/** Returns the sources for the URL of a file. The server may publish its session next to the file. */
export async function sourceOf(file: URL, given: SessionAddress | null): Promise<Source> {
  return { session: given ?? (await lookUpSession(file)), name: nameOf(file.pathname), file: file.href };
}

/** Returns the name of a scene from the path of its file. */
export function nameOf(path: string): string {
  const name = path
    .split("/")
    .pop()!
    .replace(/\.swz$/, "");
  try {
    return decodeURIComponent(name);
  } catch {
    return name; // the file name contains a literal percent sign
  }
}
