// The worker: receives, decodes and conceals, so that the page never waits for it.

import { readPreview } from "./codec/preview.ts";
import type { Pause } from "./conceal/conceal.ts";
import type { Camera } from "./model/camera.ts";
import type { Head } from "./packets/container.ts";
import { buffersOf, pack } from "./render/packed.ts";
import type { Counts, Listener } from "./transport/events.ts";
import type { FromWorker, ToWorker } from "./transport/messages.ts";
import { Received } from "./transport/received.ts";
import { receiveBytes, receiveFile } from "./transport/reliable.ts";
import { askServer, receiveDatagrams, type Session } from "./transport/webtransport.ts";
import { nextTurn } from "./turns.ts";
import { warmUp } from "./warm.ts";

const SHOW_MS = 30,
  COUNT_MS = 200,
  SLICE_MS = 8;

/** For what looks the same to all cameras. */
const ANYWHERE: Camera = { viewmat: [], focal: 1, width: 1, height: 1, margin: 0 };

const say = (message: FromWorker, hand: ArrayBuffer[] = []): void => self.postMessage(message, { transfer: hand });

class Reception implements Listener {
  #received: Received | null = null;
  #shownAt = 0;
  #ask = 0;
  /** Where the page looks from, its number, and whether it was answered. */
  #camera = ANYWHERE;
  #look = 0;
  #looked = 0;
  #drawing: Promise<void> | null = null;
  #decodeMs = 0;
  #counts: Counts | null = null;
  #countedAt = 0;
  #waiting: Uint8Array[] = [];
  #working: Promise<void> | null = null;

  /** One that is no preview is nothing to fail for. */
  preview(bytes: Uint8Array): void {
    try {
      const { splats, background } = readPreview(bytes),
        packed = pack([splats], 0, 1);
      say({ kind: "preview", packed, background }, buffersOf(packed));
    } catch (error) {
      say({ kind: "note", text: (error as Error).message });
    }
  }

  /** A second way brings the head once more: what is there stays. */
  head(head: Head): void {
    if (this.#received?.decoder.head.manifest.streamId === head.manifest.streamId) return;
    this.#received = new Received(head);
    const { decoder } = this.#received,
      { manifest } = head,
      section = decoder.schema.sections.get("preview");
    if (section) this.preview(section);
    const facts = {
      gaussians: manifest.count,
      packets: manifest.numPackets,
      degree: decoder.schema.degree,
      viewDependent: decoder.schema.viewDependent,
      size: decoder.schema.size,
      middle: decoder.schema.middle,
      background: decoder.background,
      viewpoint: decoder.viewpoint,
      sideInfoBytes: manifest.sideInfoBytes,
      concealers: Object.keys(decoder.schema.concealers),
    };
    say({ kind: "facts", facts });
  }

  packets(packets: Uint8Array[]): void {
    for (const bytes of packets) this.#waiting.push(bytes);
    this.#working ??= this.#decode();
  }

  counts(counts: Counts): void {
    this.#counts = counts;
    if (performance.now() - this.#countedAt > COUNT_MS) this.#tell(counts);
  }

  #tell(counts: Counts): void {
    this.#countedAt = performance.now();
    const intake = this.#received?.decoder.intake,
      packets = Math.max(counts.packets, intake?.size ?? 0);
    say({
      kind: "counts",
      counts: { ...counts, packets },
      decodeMs: this.#decodeMs,
      corrupt: intake?.counts.corrupt ?? 0,
    });
  }

  /** Resolves when everything that came is decoded and handed over. */
  async settled(): Promise<void> {
    await this.#working;
    await this.#draw();
    if (this.#counts) this.#tell(this.#counts);
  }

  /** Decodes what waits, a little at a time: the session must be served meanwhile. */
  async #decode(): Promise<void> {
    for (let next = 0; next < this.#waiting.length; ) {
      const began = performance.now();
      while (next < this.#waiting.length && performance.now() - began < SLICE_MS)
        this.#received!.take(this.#waiting[next++]);
      this.#decodeMs += performance.now() - began;
      if (performance.now() - this.#shownAt > SHOW_MS) void this.#draw();
      await nextTurn();
    }
    this.#waiting = [];
    this.#working = null;
  }

  stopped(): boolean {
    return false;
  }

  look({ camera, ask }: ToWorker & { kind: "look" }): void {
    this.#camera = camera;
    this.#look = ask;
    void this.#draw();
  }

  /** Hands over what was decoded since the last time, or everything anew where the page looks from somewhere else. */
  #draw(): Promise<void> {
    return (this.#drawing ??= this.#drawAll().finally(() => (this.#drawing = null)));
  }

  async #drawAll(): Promise<void> {
    const received = this.#received;
    this.#shownAt = performance.now();
    if (!received || (received.decoder.schema.viewDependent && !this.#look)) return;
    while (received.hasNew || this.#looked !== this.#look) {
      const ask = this.#look,
        shown = await received.seen(
          this.#camera,
          this.#looked !== ask,
          pausing(() => true),
        );
      if (!shown) return;
      this.#looked = ask;
      const { parts, instead, fresh, elements } = shown,
        gains = instead ? received.gains : null,
        { degree, size } = received.decoder.schema;
      const packed = pack(parts, degree, size),
        hand = [...buffersOf(packed), ...(gains ? [gains.buffer as ArrayBuffer] : [])];
      say({ kind: "splats", packed, instead, fresh, elements, gains, ask }, hand);
    }
  }

  async conceal({ choice, ask }: ToWorker & { kind: "conceal" }): Promise<void> {
    const received = this.#received;
    if (!received) return;
    const pause = pausing(() => this.#ask === ask);
    this.#ask = ask;
    try {
      await received.prepare(choice, pause);
    } catch (error) {
      say({
        kind: "note",
        text: `The stream's copies cannot be used, nothing is concealed: ${(error as Error).message}.`,
      });
      choice = { ...choice, concealer: "drop" };
    }
    await this.#draw();
    const shownPackets = await received.conceal(choice, pause),
      { gains } = received;
    if (shownPackets !== null && gains) say({ kind: "gains", gains, shownPackets, ask }, [gains.buffer as ArrayBuffer]);
  }

  digest(): void {
    const decoder = this.#received?.decoder;
    say({ kind: "digest", found: decoder?.digest() ?? "", expected: decoder?.head.manifest.symbolsDigest ?? "" });
  }

  get begun(): boolean {
    return this.#received !== null;
  }
}

/** Lets other work of this thread through now and then. */
function pausing(wanted: () => boolean): Pause {
  let since = performance.now();
  return async () => {
    if (performance.now() - since > SLICE_MS) {
      await nextTurn();
      since = performance.now();
    }
    return wanted();
  };
}

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

async function open({ session, name, file, bytes }: ToWorker & { kind: "open" }): Promise<string> {
  if (bytes) return receiveBytes(bytes, reception);
  void warmUp(() => !reception.begun);
  if (!session) return receiveFile(file, reception);
  let ended: string;
  try {
    ended = await receiveSession(session, name, file);
    if (["complete", "sent", "stopped"].includes(ended)) return ended;
  } catch (error) {
    ended = (error as Error).message;
  }
  say({ kind: "note", text: `${reception.begun ? "The rest comes" : "The stream comes"} by HTTP: ${ended}.` });
  return receiveFile(file, reception);
}

self.addEventListener("message", ({ data }: MessageEvent<ToWorker>) => {
  if (data.kind === "conceal") return void reception.conceal(data);
  if (data.kind === "look") return reception.look(data);
  if (data.kind === "digest") return reception.digest();
  open(data).then(
    async (text) => {
      await reception.settled();
      say({ kind: "finished", text, complete: text === "complete" });
    },
    async (error: unknown) => {
      await reception.settled();
      say({ kind: "failed", text: (error as Error).message });
    },
  );
});
