// The reliable way: the stream as a file, over HTTP or out of the page itself; packets are taken as they come.

import { BitstreamError } from "../bytes.ts";
import { isStream } from "../packets/container.ts";
import type { Listener } from "./events.ts";
import type { Gap, Held } from "./held.ts";
import { type Answer, type HttpFile, PastEnd, RangeUnsupported, readBytes } from "./http_file.ts";
import { Damaged, PacketReader } from "./packet_reader.ts";
import { DamagedTiles, receiveTiles } from "./tiles.ts";

const WAY = "HTTP, in order and without loss";
/** How often damaged bytes are requested again without any progress, and how often a file may be replaced meanwhile. */
const MAX_REPEATS = 2;
const MAX_CHANGES = 3;

const NO_STREAM = "the server answers with something that is no splatwire stream";

/** The file is another one than that of the packets that are held. */
class Changed extends Error {}

/**
 * Fetches the missing packets of a stream's file; returns the words for how it ended. Bytes that are damaged are
 * requested again, a file that was replaced is received from its beginning, and a server without ranges gives the whole
 * file. Throws where the connection breaks, the server refuses, or the file is no stream.
 */
export async function receiveFile(file: HttpFile, listener: Listener, held: Held): Promise<string> {
  let fallback = false;
  for (;;) {
    const { count } = held;
    try {
      if (file.ranges === "unusable" && !(held.complete && file.compared))
        return await receiveWhole(file, listener, held);
      if (!held.begun) return await receiveFresh(file, listener, held);
      if (!file.compared) await compare(file, listener, held);
      if (file.ranges === "unusable" && !held.complete) continue;
      const { fetching } = listener;
      return fetching ? await receiveTiles(file, listener, held, fetching) : await receiveGaps(file, listener, held);
    } catch (error) {
      if (held.count > count) file.damages = file.useless = 0;
      if (error instanceof RangeUnsupported && file.ranges !== "unusable") {
        file.ranges = "unusable";
        fallback = true;
      } else if (error instanceof Changed) {
        if (++file.changes > MAX_CHANGES)
          throw new BitstreamError(`${file.url} is replaced again and again while it is read`);
        held.clear();
        listener.changed?.();
        file.damagedTiles.clear();
      } else if (error instanceof DamagedTiles) {
        file.compared = false;
        await file.wait(1);
      } else if (error instanceof Damaged || error instanceof PastEnd) {
        const { cause } = error;
        if (++file.damages > MAX_REPEATS) {
          if (cause instanceof BitstreamError) throw cause;
          if (!held.begun) throw new BitstreamError(error.message);
          return missingIn(held);
        }
        if (!held.begun) file.ranges = "unusable"; // a part may be another one than the server declares
        file.compared = false;
        await file.wait(file.damages);
      } else {
        if (fallback && error instanceof TypeError) file.ranges = "unknown"; // the connection was at fault
        throw error;
      }
    }
  }
}

/** Compares the file's manifest with the one that is held. Throws `Changed` where they differ. */
async function compare(file: HttpFile, listener: Listener, held: Held): Promise<void> {
  const known = held.manifestBytes,
    answer = await file.request(0, known.length, file.cache === "default" ? "no-cache" : file.cache);
  try {
    const bytes = await readBytes(answer, known.length);
    if (bytes.length < known.length || !isStream(bytes)) {
      file.noteUseless("the server gives too few bytes");
      throw new Damaged(NO_STREAM, { cause: new BitstreamError(NO_STREAM) });
    }
    if (!held.isSame(bytes)) throw new Changed();
    file.compared = true;
    listener.confirmed?.();
  } finally {
    answer.cancel();
  }
}

/** Reads the file from its beginning: a first part and, unless a view chooses what it needs, the rest. */
async function receiveFresh(file: HttpFile, listener: Listener, held: Held): Promise<string> {
  const { firstBytes } = file.limits;
  let answer = await file.request(0, firstBytes),
    begin = 0,
    end = 0;
  const reader = new PacketReader(listener, held, answer.keep),
    tally = new Tally(listener, held);
  for (;;) {
    try {
      for (let piece = await answer.read(); piece; piece = await answer.read()) {
        end += piece.length;
        if (listener.stopped()) return "stopped";
        reader.feed(piece);
        if (reader.head) file.compared = true;
        tally.add(piece.length);
        if (held.complete) return "complete";
      }
    } finally {
      answer.cancel();
    }
    // a server may give less than was requested, but something
    if (answer.whole || end === begin || (answer.total === null && end - begin < firstBytes)) break;
    if (reader.head && listener.fetching) return receiveTiles(file, listener, held, listener.fetching);
    begin = end;
    try {
      answer = await file.request(end, reader.head ? null : end + firstBytes);
    } catch (error) {
      if (error instanceof PastEnd) break; // the last part ended with the file
      throw error;
    }
  }
  throw new Damaged(reader.head ? missingIn(held) : "the file ends before its side information does");
}

/** Reads the missing packets of a file, run by run. */
async function receiveGaps(file: HttpFile, listener: Listener, held: Held): Promise<string> {
  const tally = new Tally(listener, held);
  tally.add(0);
  for (let before = -1; held.count > before; ) {
    before = held.count; // a server may give less than was requested
    for (const gap of held.gaps) {
      if (listener.stopped()) return "stopped";
      await receiveGap(file, gap, listener, held, tally);
    }
  }
  if (!held.complete) throw new Damaged(missingIn(held));
  return "complete";
}

async function receiveGap(file: HttpFile, gap: Gap, listener: Listener, held: Held, tally: Tally): Promise<void> {
  const answer = await file.request(gap.offset, gap.end),
    reader = new PacketReader(listener, held, answer.keep, held.head, gap.place);
  try {
    for (let piece = await answer.read(); piece; piece = await answer.read()) {
      reader.feed(piece);
      tally.add(piece.length);
      if (reader.intact) file.ranges = "usable";
      if (held.complete || listener.stopped()) return;
    }
  } catch (error) {
    if (!(error instanceof Damaged)) throw error;
    if (gap.end !== null) return;
    if (!reader.intact) file.noteUseless(error.message);
    throw error;
  } finally {
    answer.cancel();
  }
}

/** Reads the whole file by one request, and skips what is held already. */
async function receiveWhole(file: HttpFile, listener: Listener, held: Held): Promise<string> {
  const answer = await file.request(null);
  try {
    const ended = await readAll(answer, listener, held, new Tally(listener, held));
    if (ended) return ended;
  } finally {
    answer.cancel();
  }
  throw new Damaged(missingIn(held));
}

/** The same for bytes that are there already. */
export async function receiveBytes(bytes: Uint8Array<ArrayBuffer>, listener: Listener, held: Held): Promise<string> {
  const stream = new Response(bytes).body!.getReader(),
    read = async (): Promise<Uint8Array | null> => (await stream.read()).value ?? null,
    answer = { offset: 0, whole: true, total: bytes.length, keep: false, read, cancel: () => undefined };
  try {
    return (await readAll(answer, listener, held, new Tally(listener, held, "in this file"))) ?? missingIn(held);
  } catch (error) {
    if (!(error instanceof Damaged) || !held.begun) throw (error as Error).cause ?? error;
    return error.message;
  }
}

/** Reads an answer that begins with the file; returns how it ended, or null where packets are missing. */
async function readAll(answer: Answer, listener: Listener, held: Held, tally: Tally): Promise<string | null> {
  const reader = new PacketReader(listener, held, answer.keep);
  for (let piece = await answer.read(); piece; piece = await answer.read()) {
    if (listener.stopped()) return "stopped";
    reader.feed(piece);
    tally.add(piece.length);
    if (reader.head && held.complete) return "complete";
  }
  if (!reader.head) throw new Damaged("the file ends before its side information does");
  return held.complete ? "complete" : null;
}

function missingIn({ head, count }: Held): string {
  const missing = (head?.manifest.numPackets ?? 0) - count;
  return `${missing} ${missing === 1 ? "packet is" : "packets are"} damaged or not in the file`;
}

/** Reports bytes and packets. */
class Tally {
  #bytes = 0;
  readonly #began = performance.now();

  constructor(
    readonly listener: Listener,
    readonly held: Held,
    readonly way = WAY,
  ) {}

  add(bytes: number): void {
    this.#bytes += bytes;
    this.listener.counts({
      way: this.way,
      bytes: this.#bytes,
      packets: this.held.count,
      expected: this.held.head?.manifest.numPackets ?? 0,
      lost: 0,
      rejected: 0,
      seconds: (performance.now() - this.#began) / 1000,
    });
  }
}
