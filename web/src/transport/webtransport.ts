// WebTransport: side information on a reliable stream, packets as datagrams; lost ones are asked for again.

import { BUDGET, type Look } from "../codec/levels/cut.ts";
import { pause } from "../turns.ts";
import type { Listener } from "./events.ts";
import { FrameReader } from "./frames.ts";
import { type Before, Transfer } from "./transfer.ts";

const FEEDBACK_MS = 20,
  PATIENCE_MS = 4000,
  SILENCE_MS = 10000;
/** A view is not told sooner after another one, and so often at once; then again, since it may be lost. */
const VIEW_MS = 100,
  TWICE = 2,
  VIEW_AGAIN_MS = 1000,
  IDLE_MS = 1000;
/** With a budget of nothing: what comes in any case comes, and then nothing until it is known what is looked at. */
const NOWHERE: Look = {
  viewmat: [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
    [0, 0, 1, 0],
  ],
  focal: 1,
  width: 1,
  height: 1,
};
/** Datagrams that wait for a thread that is busy; a browser throws away what is beyond. */
const MOST_WAITING = 1024;
/** When handshakes begin, as long as none has come about. */
const HANDSHAKES_MS = [0, 50, 120, 250, 500, 1000];

export interface Session {
  readonly url: string;
  /** SHA-256 of a self-signed certificate, hexadecimal; none for a certificate that the browser knows. */
  readonly fingerprint?: string;
}

/** This browser or page cannot open sessions. */
export class NoWebTransport extends Error {}

/** Where a server says beside a stream's file that it takes sessions; none where it is no such server. */
export async function askServer(file: URL): Promise<Session | null> {
  if (!file.pathname.includes("/streams/")) return null;
  try {
    const answer = await fetch(new URL("../streams.json", file), { signal: AbortSignal.timeout(PATIENCE_MS) });
    const { port, path, fingerprint } = (await answer.json()) as Record<string, unknown>;
    if (!answer.ok || typeof port !== "number" || typeof path !== "string") return null;
    const url = `https://${file.hostname}:${port}${path}`;
    return typeof fingerprint === "string" ? { url, fingerprint } : { url };
  } catch {
    return null;
  }
}

/**
 * Receives a stream, or what there was not `before` of it, until it is complete; gives the words for how it ended.
 * Throws where no session comes about. The listener is told whether it is still the stream of which there is a part.
 */
export async function receiveDatagrams(
  session: Session,
  name: string,
  listener: Listener,
  before: Before | null = null,
): Promise<string> {
  if (typeof WebTransport === "undefined") throw new NoWebTransport("this browser or page has no WebTransport");
  const transport = await open(session),
    transfer = new Transfer(name, crypto.getRandomValues(new BigUint64Array(1))[0], performance.now(), before);
  const end = (error: unknown): void =>
    void (transfer.finished ??= `the session ended: ${(error as Error)?.message ?? "closed"}`);
  transport.closed.then(end, end);
  transport.datagrams.incomingHighWaterMark = MOST_WAITING;
  const stream = await inTime(transport.createBidirectionalStream()).catch((error: unknown) => {
    transport.close();
    throw error;
  });
  const onStream = stream.writable.getWriter(),
    datagrams = transport.datagrams.writable.getWriter(),
    request = transfer.request();
  for (const one of [request, ...transfer.have()]) {
    datagrams.write(one).catch(() => undefined); // beside the stream, which waits longer where the first is lost
    onStream.write(Uint8Array.of(one.length & 255, one.length >> 8, ...one)).catch(() => undefined);
  }
  let heardAt = performance.now();
  const frames = new FrameReader();
  readAll(stream.readable, (chunk) => {
    heardAt = performance.now();
    for (const bytes of frames.feed(chunk)) transfer.receive(bytes, heardAt);
  }).catch(end);
  readAll(transport.datagrams.readable, (bytes) => {
    heardAt = performance.now();
    transfer.receive(bytes, heardAt);
  }).catch(end);
  const progress = new Progress(transfer, listener),
    looker = new Looker(transfer, listener);
  while (!transfer.finished) {
    await pause(FEEDBACK_MS);
    const now = performance.now();
    if (listener.stopped()) transfer.finished = "stopped";
    else if (now - heardAt > SILENCE_MS) transfer.finished = "the server fell silent";
    else
      for (const bytes of transfer.welcome ? looker.says(now) : [request])
        datagrams.write(bytes).catch(() => undefined);
    if (!looker.seen) progress.tell();
    looker.look(now);
  }
  progress.tell();
  if (transfer.welcome) for (let n = 0; n < 3; n++) await datagrams.write(transfer.bye()).catch(() => undefined);
  transport.close();
  if (transfer.headMs === null && !transfer.goesOn && transfer.finished !== "stopped")
    throw new Error(transfer.finished);
  return transfer.finished;
}

/** Says where somebody looks from, and what came; little once all of that is there. */
class Looker {
  #looking: Look | null = null;
  #sawFrom: Look | null = null;
  #times = 0;
  #toldAt = -Infinity;
  #reportedAt = -Infinity;
  #seenAt = Infinity;

  constructor(
    readonly transfer: Transfer,
    readonly listener: Listener,
  ) {}

  /** Whether all that somebody looks at came. */
  get seen(): boolean {
    return this.#seenAt < Infinity;
  }

  look(now: number): void {
    const seen = this.transfer.ended && this.transfer.viewing;
    // Who looks elsewhere and needs nothing more for it hears of that, too: nothing comes then.
    if (seen && (!this.seen || this.#sawFrom !== this.#looking)) this.listener.sawAll?.();
    if (seen) this.#sawFrom = this.#looking;
    this.#seenAt = seen ? Math.min(this.#seenAt, now) : Infinity;
  }

  says(now: number): Uint8Array[] {
    const { transfer } = this,
      looks = transfer.welcome!.viewable && this.listener.looking !== undefined,
      looking = looks ? (this.listener.looking ?? NOWHERE) : null,
      said: Uint8Array[] = [];
    if (looking !== this.#looking) this.#times = 0;
    if (looking && now - this.#toldAt >= (this.#times < TWICE ? VIEW_MS : VIEW_AGAIN_MS)) {
      said.push(transfer.view(looking, looking === NOWHERE ? 1 : BUDGET));
      this.#toldAt = now;
      this.#times++;
      this.#looking = looking;
    }
    if (now - this.#reportedAt >= (now - this.#seenAt > IDLE_MS ? IDLE_MS / 2 : 0)) {
      said.push(transfer.feedback(now));
      this.#reportedAt = now;
    }
    return said;
  }
}

/** Tells what is new: the preview once, the head once, packets as they come. */
class Progress {
  #preview = false;
  #heads = 0;
  #live = false;

  constructor(
    readonly transfer: Transfer,
    readonly listener: Listener,
  ) {}

  tell(): void {
    const { transfer, listener } = this;
    if (transfer.welcome && !this.#preview) {
      this.#preview = true;
      if (transfer.goesOn) this.#heads = -1;
      if (transfer.before) (transfer.goesOn ? listener.confirmed : listener.changed)?.call(listener);
      if (transfer.welcome.preview.length) listener.preview(transfer.welcome.preview);
    }
    this.#live ||= transfer.welcome?.open ?? false;
    if (transfer.head && this.#heads >= 0 && this.#heads !== transfer.heads) {
      this.#heads = transfer.heads;
      listener.head(transfer.head, transfer.fileHead, !this.#live, this.#live);
    }
    if (transfer.head && transfer.fresh.length) listener.packets(transfer.fresh.splice(0));
    listener.counts({
      way: "WebTransport datagrams",
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
 * The first session that opens. A first flight that loses its first datagram can make the server refuse the handshake,
 * and one that loses a later one waits long: others begin beside it.
 */
async function open({ url, fingerprint }: Session): Promise<WebTransport> {
  const options: WebTransportOptions = { requireUnreliable: true, congestionControl: "low-latency" },
    begun: WebTransport[] = [];
  if (fingerprint) {
    const value = Uint8Array.from(fingerprint.match(/../g) ?? [], (digits) => parseInt(digits, 16));
    options.serverCertificateHashes = [{ algorithm: "sha-256", value }];
  }
  let found: WebTransport | null = null;
  const attempts = HANDSHAKES_MS.map(async (ms) => {
    await pause(ms);
    if (found) return found;
    const transport = new WebTransport(url, options);
    begun.push(transport);
    transport.closed.catch(() => undefined);
    await transport.ready;
    return (found ??= transport);
  });
  try {
    return await inTime(Promise.any(attempts));
  } catch (error) {
    throw error instanceof AggregateError ? error.errors[0] : error;
  } finally {
    for (const transport of begun) if (transport !== found) transport.close();
  }
}

/** Result of a promise. Throws if a server takes too long for it. */
function inTime<T>(work: Promise<T>): Promise<T> {
  const late = pause(PATIENCE_MS).then(() => Promise.reject(new Error("no answer to a WebTransport session")));
  return Promise.race([work, late]);
}
