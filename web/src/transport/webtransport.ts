// WebTransport source: side information on a reliable stream, packets as datagrams, lost ones by NACK.

import { BUDGET, type ViewCamera } from "../codec/levels/cut.ts";
import { delay } from "../scheduler.ts";
import type { Listener } from "./events.ts";
import { permitted } from "./page_policy.ts";
import { type StoredStream, Transfer } from "./transfer.ts";
import { FEEDBACK_MS, MAX_NAME } from "./wire.ts";
import { MessageReader } from "./wire_messages.ts";

/** Maximum time until a session is open, or the server answers a look-up, milliseconds. */
const SESSION_TIMEOUT_MS = 4000;
const NO_ANSWER = "no answer to a WebTransport session";
/** Time without anything new from the server after which a session ends, milliseconds. */
const SILENCE_TIMEOUT_MS = 10_000;
/** Interval in which a server must send `MIN_NEW` symbols and packets, unless it may have nothing to send; ms. */
const PACE_MS = 30_000;
/** Minimum number of new symbols and packets in `PACE_MS`. A server that sends fewer ends the session. */
const MIN_NEW = 8;
/** How a session with a slower server ends. */
export const TOO_SLOW = "the server sends too slowly";
/** Minimum interval between view updates, milliseconds. */
const VIEW_INTERVAL_MS = 100;
/** Number of repetitions of a view update at this interval, because updates may be lost. */
const IMMEDIATE_UPDATES = 2;
/** Interval of later repetitions, milliseconds. */
const VIEW_REPEAT_MS = 1000;
/** Time after all tiles of the view were sent, from which feedback is sent at half this interval, milliseconds. */
const IDLE_MS = 1000;
/** Number of `BYE` datagrams that end a transfer. */
const NUM_BYES = 3;
/**
 * Maximum wait until the browser has sent them, milliseconds. Datagrams to a server that fell silent stay in the
 * browser until the session's idle timeout.
 */
const BYE_TIMEOUT_MS = 200;
/** View without a budget. The server sends only the base tiles until the camera is known. */
const NO_VIEW: ViewCamera = {
  viewmat: [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 0],
  ],
  focal: 1,
  width: 1,
  height: 1,
};
/** Size of the datagram queue. The browser drops further datagrams while the thread is busy. */
const MAX_QUEUED_DATAGRAMS = 1024;
/** Start times of parallel handshakes, milliseconds. */
const HANDSHAKES_MS = [0, 50, 120, 250, 500, 1000];
/**
 * Number of failed handshakes after which no further one starts. Chromium doubles the delay of new handshakes with
 * every one that failed within the last minutes.
 */
const MAX_FAILED_HANDSHAKES = 2;
/** Of this many attempts at a session with `localhost` that fails, one is made at the other address. */
const OTHER_ADDRESS = 4;
/**
 * `SESSION_TIMEOUT_MS` for further sessions of a stream without another source, milliseconds. After many failures,
 * Chromium delays their handshakes by up to 90 s; a shorter limit would end each one before it begins.
 */
const ONLY_SOURCE_TIMEOUT_MS = 120_000;

/**
 * A character that a server accepts in no name: Python's `isprintable` is false for it. The two may know different
 * versions of Unicode.
 */
const NOT_PRINTABLE = /\p{C}|[^ \P{Z}]/u;

/** Address of a server's WebTransport sessions. */
export interface SessionAddress {
  readonly url: string;
  /** SHA-256 of a self-signed certificate, hexadecimal. Absent for certificates that the browser trusts. */
  readonly fingerprint?: string;
}

/** Options of opening a session. */
export interface SessionOptions {
  /** True if an earlier session of this visit failed. It is then opened with one handshake. */
  readonly isRetry: boolean;
  /** True if the stream has no file, so that there is nothing else to try. */
  readonly isOnlySource: boolean;
}

const FIRST_SESSION: SessionOptions = { isRetry: false, isOnlySource: false };

/** Error for a browser, page or stream name for which no session can be opened. */
export class NoWebTransport extends Error {
  readonly final = true;
}

/** Looks up the WebTransport session that a server publishes next to its files. Returns null for other servers. */
export async function lookUpSession(file: URL): Promise<SessionAddress | null> {
  if (!file.pathname.includes("/streams/")) return null;
  try {
    const answer = await fetch(new URL("../streams.json", file), { signal: AbortSignal.timeout(SESSION_TIMEOUT_MS) });
    const { port, path, fingerprint } = (await answer.json()) as Record<string, unknown>;
    if (!answer.ok || typeof port !== "number" || typeof path !== "string") return null;
    const url = `https://${file.hostname}:${port}${path}`;
    return typeof fingerprint === "string" ? { url, fingerprint } : { url };
  } catch {
    return null;
  }
}

/**
 * Receives a stream, without the packets in `before`, and returns how it ended. Notifies the listener whether the
 * stored packets are still valid. Throws if no session can be opened, if it ends before the head arrives (unless
 * stopped), or if the listener rejects the stream.
 */
export async function receiveDatagrams(
  session: SessionAddress,
  name: string,
  listener: Listener,
  before: StoredStream | null = null,
  options = FIRST_SESSION,
): Promise<string> {
  if (typeof WebTransport === "undefined") throw new NoWebTransport("this browser or page has no WebTransport");
  if (new TextEncoder().encode(name).length > MAX_NAME || NOT_PRINTABLE.test(name))
    throw new NoWebTransport(`the name of the stream has more than ${MAX_NAME} bytes, or is not printable`);
  const transport = await openSession(session, options),
    transfer = new Transfer(name, crypto.getRandomValues(new BigUint64Array(1))[0], performance.now(), before);
  const end = (error: unknown): void =>
    void (transfer.finished ??= `the session ended: ${(error as Error)?.message ?? "closed"}`);
  transport.closed.then(end, end);
  transport.datagrams.incomingHighWaterMark = MAX_QUEUED_DATAGRAMS;
  const stream = await withTimeout(transport.createBidirectionalStream()).catch((error: unknown) => {
    transport.close();
    throw error;
  });
  const streamWriter = stream.writable.getWriter(),
    datagramWriter = transport.datagrams.writable.getWriter(),
    request = transfer.request();
  const send = (messages: readonly Uint8Array[]): void => {
    for (const one of messages) {
      // also as a datagram, because the stream waits longer if its first packet is lost
      datagramWriter.write(one).catch(() => undefined);
      streamWriter.write(Uint8Array.of(one.length & 255, one.length >> 8, ...one)).catch(() => undefined);
    }
  };
  send([request]);
  let changedAt = performance.now(),
    lastActivity = NaN,
    windowStartActivity = NaN,
    windowStartedAt = changedAt;
  const reader = new MessageReader();
  readAll(stream.readable, (chunk) => {
    const now = performance.now();
    for (const bytes of reader.feed(chunk)) transfer.receive(bytes, now, false);
    send(transfer.takeHaveMessages());
  }).catch(end);
  readAll(transport.datagrams.readable, (bytes) => {
    transfer.receive(bytes, performance.now());
    send(transfer.takeHaveMessages());
  }).catch(end);
  const delivery = new Delivery(transfer, listener),
    scheduler = new FeedbackScheduler(transfer, listener);
  try {
    while (!transfer.finished) {
      await delay(FEEDBACK_MS);
      const now = performance.now(),
        latest = transfer.activity;
      if (latest !== lastActivity || now < transfer.waitUntil) [lastActivity, changedAt] = [latest, now];
      if (transfer.mayIdle || now < transfer.waitUntil || !(Math.abs(latest - windowStartActivity) < MIN_NEW))
        [windowStartActivity, windowStartedAt] = [latest, now];
      if (listener.stopped()) transfer.finished = "stopped";
      else if (now - changedAt > SILENCE_TIMEOUT_MS) transfer.finished = "the server sends nothing new";
      else if (now - windowStartedAt > PACE_MS) transfer.finished = TOO_SLOW;
      else
        for (const bytes of transfer.welcome ? scheduler.messages(now) : now < transfer.waitUntil ? [] : [request])
          datagramWriter.write(bytes).catch(() => undefined);
      if (!scheduler.isComplete) delivery.deliver();
      scheduler.update(now);
    }
    delivery.deliver();
    if (transfer.welcome) {
      const byes = Array.from({ length: NUM_BYES }, () => datagramWriter.write(transfer.bye()).catch(() => undefined));
      await Promise.race([Promise.all(byes), delay(BYE_TIMEOUT_MS)]);
    }
  } finally {
    transport.close(); // also if the listener rejects the stream
  }
  if (transfer.initSegmentMs === null && !transfer.isSameStream && transfer.finished !== "stopped")
    throw new Error(transfer.finished);
  return transfer.finished;
}

/** Creates view updates and feedback when they are due: at a low rate once all tiles of the view were sent. */
class FeedbackScheduler {
  #sentCamera: ViewCamera | null = null;
  #completeCamera: ViewCamera | null = null;
  #numSent = 0;
  #sentAt = -Infinity;
  #feedbackAt = -Infinity;
  #completeAt = Infinity;

  constructor(
    readonly transfer: Transfer,
    readonly listener: Listener,
  ) {}

  /** True if all tiles of the view were sent. */
  get isComplete(): boolean {
    return this.#completeAt < Infinity;
  }

  update(now: number): void {
    const isComplete = this.transfer.isAllSent && this.transfer.hasSentView;
    // A view change that needs no further tiles is reported, too, because no packet follows.
    if (isComplete && (!this.isComplete || this.#completeCamera !== this.#sentCamera)) this.listener.viewComplete?.();
    if (isComplete) this.#completeCamera = this.#sentCamera;
    this.#completeAt = isComplete ? Math.min(this.#completeAt, now) : Infinity;
  }

  messages(now: number): Uint8Array[] {
    const { transfer } = this,
      hasView = transfer.welcome!.viewDependent && this.listener.camera !== undefined,
      camera = hasView ? (this.listener.camera ?? NO_VIEW) : null,
      messages: Uint8Array[] = [];
    if (camera !== this.#sentCamera) this.#numSent = 0;
    if (camera && now - this.#sentAt >= (this.#numSent < IMMEDIATE_UPDATES ? VIEW_INTERVAL_MS : VIEW_REPEAT_MS)) {
      messages.push(transfer.viewUpdate(camera, camera === NO_VIEW ? 1 : BUDGET));
      this.#sentAt = now;
      this.#numSent++;
      this.#sentCamera = camera;
    }
    if (now - this.#feedbackAt >= (now - this.#completeAt > IDLE_MS ? IDLE_MS / 2 : 0)) {
      messages.push(transfer.feedback(now));
      this.#feedbackAt = now;
    }
    return messages;
  }
}

/** Delivers new data to the listener: the preview once, the newest head if there is a new one, and new packets. */
class Delivery {
  #preview = false;
  #heads = 0;
  #beganLive = false;
  #isCompared = false;

  constructor(
    readonly transfer: Transfer,
    readonly listener: Listener,
  ) {}

  deliver(): void {
    const { transfer, listener } = this;
    if (!this.#isCompared && transfer.before && transfer.isSameStream !== null) {
      this.#isCompared = true;
      (transfer.isSameStream ? listener.confirmed : listener.changed)?.call(listener);
    }
    if (transfer.welcome && !this.#preview) {
      this.#preview = true;
      if (transfer.welcome.preview.length) listener.preview(transfer.welcome.preview);
    }
    this.#beganLive ||= transfer.welcome?.isLive ?? false;
    if (transfer.head && this.#heads !== transfer.numInitSegments) {
      this.#heads = transfer.numInitSegments;
      listener.head(transfer.head, transfer.fileHead, !this.#beganLive, this.#beganLive);
    }
    if (transfer.head && transfer.newPackets.length) listener.packets(transfer.newPackets.splice(0));
    listener.counts({
      transport: "WebTransport datagrams",
      bytes: transfer.counts.bytes,
      packets: transfer.counts.packets,
      expected: transfer.welcome?.packets ?? 0,
      lost: transfer.datagramsLost,
      rejected: transfer.counts.rejected,
      seconds: (performance.now() - transfer.began) / 1000,
    });
  }
}

async function readAll(readable: ReadableStream<Uint8Array>, take: (chunk: Uint8Array) => void): Promise<void> {
  const reader = readable.getReader();
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    take(value);
  }
}

/**
 * URL at which a session with `localhost` was opened, and the number of failures there since, by the address with its
 * fingerprint: a restarted server may listen elsewhere.
 */
const openedAt = new Map<string, { readonly url: string; failures: number }>();

/**
 * Opens a session. For `localhost`, Chromium tries only [::1], and servers listen on 127.0.0.1 by default, which is
 * therefore tried first. After a session was open, each attempt tries only one of the two, because each failed
 * handshake delays the next ones: the one that was open, and the other one every `OTHER_ADDRESS` attempts.
 */
async function openSession(session: SessionAddress, options: SessionOptions): Promise<WebTransport> {
  const address = new URL(session.url);
  if (!/(^|\.)localhost\.?$/.test(address.hostname)) return openSessionAt(session, options);
  address.hostname = "127.0.0.1";
  const key = `${session.url} ${session.fingerprint}`,
    known = openedAt.get(key),
    both = [address.href, session.url],
    isOthersTurn = known && (known.failures + 1) % OTHER_ADDRESS === 0;
  let failure: unknown;
  for (const url of known ? both.filter((one) => (one === known.url) !== isOthersTurn) : both)
    try {
      const transport = await openSessionAt({ ...session, url }, options);
      openedAt.set(key, { url, failures: 0 });
      return transport;
    } catch (error) {
      failure = error;
      if (known) known.failures++;
      if ((error as Error).message === NO_ANSWER) break; // otherwise nothing listens there
    }
  throw failure;
}

/**
 * Opens a session with staggered parallel handshakes. A lost first datagram can make the server refuse a handshake, and
 * a lost later one delays it.
 */
async function openSessionAt(
  { url, fingerprint }: SessionAddress,
  { isRetry, isOnlySource }: SessionOptions,
): Promise<WebTransport> {
  const options: WebTransportOptions = { requireUnreliable: true, congestionControl: "low-latency" },
    transports: WebTransport[] = [],
    failures: unknown[] = [];
  if (fingerprint) {
    const value = Uint8Array.from(fingerprint.match(/../g) ?? [], (digits) => parseInt(digits, 16));
    options.serverCertificateHashes = [{ algorithm: "sha-256", value }];
  }
  let found: WebTransport | null = null;
  const attempts = (isRetry ? [0] : HANDSHAKES_MS).map(async (ms) => {
    await delay(ms);
    if (found) return found;
    if (failures.length >= MAX_FAILED_HANDSHAKES) throw failures[0];
    const transport = new WebTransport(url, options);
    transports.push(transport);
    transport.closed.catch(() => undefined);
    await permitted(url, transport.ready).catch((error: unknown) => {
      failures.push(error);
      throw error;
    });
    return (found ??= transport);
  });
  try {
    return await withTimeout(
      Promise.any(attempts),
      isRetry && isOnlySource ? ONLY_SOURCE_TIMEOUT_MS : SESSION_TIMEOUT_MS,
    );
  } catch (error) {
    throw error instanceof AggregateError ? error.errors[0] : error;
  } finally {
    for (const transport of transports) if (transport !== found) transport.close();
  }
}

/** Awaits a promise. Throws an error if the server does not answer in time. */
async function withTimeout<T>(work: Promise<T>, ms = SESSION_TIMEOUT_MS): Promise<T> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const late = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(new Error(NO_ANSWER)), ms);
  });
  try {
    return await Promise.race([work, late]);
  } finally {
    clearTimeout(timer);
  }
}
