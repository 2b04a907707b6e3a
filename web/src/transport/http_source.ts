// Reliable source of a stream: its file, over HTTP or embedded in the page. Packets are delivered on arrival.

import { BitstreamError } from "../bytes.ts";
import { differsInLengthOnly, isManifestDamaged, isStream } from "../packets/container.ts";
import type { Listener } from "./events.ts";
import { HttpError } from "./http_error.ts";
import { type Answer, type HttpFile, PastEnd, RangeUnsupported, readRange } from "./http_file.ts";
import { Damaged, PacketReader } from "./packet_reader.ts";
import type { Gap, PacketStore } from "./packet_store.ts";
import { ProgressReporter } from "./progress_reporter.ts";
import { DamagedTiles, OtherOrder, receiveTiles } from "./tiles.ts";

/**
 * Largest number of repeated requests for damaged bytes without progress, and of replacements of the file during a
 * transfer.
 */
const MAX_REPEATS = 2;
const MAX_CHANGES = 3;

const NOT_A_STREAM = "the answer is no splatwire stream",
  TOO_SHORT = "the server sends fewer bytes than requested";

/** Largest number of restarts because the file's packets have another order than assumed. */
const MAX_REORDERED = 2;

/** Error for a file other than that of the stored packets. */
class FileReplaced extends Error {}

/** Error for a file with another order of packets than assumed. */
class Reordered extends Error {}

/**
 * Receives the missing packets of a stream's file and returns how it ended.
 *
 * Damaged bytes are requested again, and a replaced file is received from the beginning. The whole file is requested if
 * range requests are unsupported or fail repeatedly. Throws if the connection breaks, the server refuses, or the file
 * is not a stream.
 */
export async function receiveFile(file: HttpFile, listener: Listener, store: PacketStore): Promise<string> {
  let fallback = false;
  for (;;) {
    const { count } = store,
      { numBegun } = file;
    try {
      if ((file.ranges === "unusable" || file.isTryingWhole) && !(store.complete && file.compared))
        return await receiveWhole(file, listener, store);
      if (!store.hasHead) return await receiveFresh(file, listener, store);
      if (!file.compared) await compare(file, listener, store);
      if (file.ranges === "unusable" && !store.complete) continue;
      const { tileRequest } = listener;
      return tileRequest && !file.isLinear
        ? await receiveTiles(file, listener, store, tileRequest)
        : await receiveGaps(file, listener, store);
    } catch (error) {
      if (store.count > count) file.damages = file.useless = 0;
      if (error instanceof RangeUnsupported && file.ranges !== "unusable") {
        file.ranges = "unusable";
        fallback = true;
      } else if (error instanceof FileReplaced) {
        file.noteChange();
        if (file.changes > MAX_CHANGES)
          throw new BitstreamError(`${file.name} is replaced again and again while it is read`);
        store.clear();
        listener.changed?.();
        file.damagedTiles.clear();
      } else if (error instanceof Reordered) {
        store.forgetOffsets();
      } else if (error instanceof OtherOrder) {
        file.isLinear = true;
      } else if (error instanceof DamagedTiles) {
        file.compared = false;
        await file.wait(1);
      } else if (error instanceof Damaged || error instanceof PastEnd) {
        const { cause } = error;
        if (++file.damages > MAX_REPEATS) {
          if (cause instanceof BitstreamError) {
            if (store.hasHead) file.ranges = "unknown"; // a web page may be in the file's place for a while
            throw file.isWebPage ? new BitstreamError(`${file.name} is a web page, such as a login`) : cause;
          }
          if (!store.hasHead) {
            file.isCut = true;
            throw new BitstreamError(error.message);
          }
          return missingIn(store);
        }
        if (!store.hasHead) file.ranges = "unusable"; // a range response may contain other bytes than declared
        file.compared = false;
        await file.wait(file.damages);
      } else {
        // the connection or the file caused the failure
        if (fallback && (error instanceof TypeError || error instanceof HttpError)) file.ranges = "unknown";
        file.noteFailure(error as Error, store.count > count || file.numBegun > numBegun);
        throw error;
      }
    }
  }
}

/** Revalidates the stored manifest against the file. Throws `FileReplaced` for a different one. */
async function compare(file: HttpFile, listener: Listener, store: PacketStore): Promise<void> {
  file.takeBegun(0); // its bytes may be older than a replacement
  const stored = store.manifestBytes,
    isDoubtful = file.cache === "reload" || file.damagedTiles.size > 0,
    cache = isDoubtful ? "reload" : "no-cache",
    bytes = await readRange(file, 0, stored.length, stored.length, cache);
  if (bytes.length < stored.length || !isStream(bytes)) {
    const reason = bytes.length && !isStream(bytes) ? NOT_A_STREAM : TOO_SHORT;
    file.noteUseless(reason);
    throw new Damaged(reason, { cause: new BitstreamError(reason) });
  }
  if (!store.isSame(bytes)) {
    if (!isManifestDamaged(bytes) && !differsInLengthOnly(bytes, stored)) throw new FileReplaced();
    const reason = "the manifest is damaged";
    throw new Damaged(reason, { cause: new BitstreamError(reason) });
  }
  file.compared = true;
  listener.confirmed?.();
}

/**
 * Reads the file from its beginning: a first range and, unless a view selects tiles, the rest. A head that an earlier
 * attempt began to receive is continued.
 */
async function receiveFresh(file: HttpFile, listener: Listener, store: PacketStore): Promise<string> {
  const { firstBytes } = file.limits,
    begun = file.takeBegun(0);
  let reader: PacketReader | null = null;
  try {
    let begin = begun.length,
      end = begin,
      answer = await file.request(begin, begin + firstBytes);
    const progress = new ProgressReporter(listener, store);
    reader = new PacketReader(listener, store, answer.keep);
    reader.feed(begun);
    for (;;) {
      try {
        for (let piece = await answer.read(); piece; piece = await answer.read()) {
          end += piece.length;
          if (listener.stopped()) return "stopped";
          reader.feed(piece);
          if (reader.head) file.compared = true;
          progress.add(piece.length);
          if (store.complete) return "complete";
        }
      } finally {
        answer.cancel();
      }
      // a server may return a shorter range than requested
      if (answer.whole || end === begin || (answer.total === null && end - begin < firstBytes)) break;
      if (reader.head && listener.tileRequest) return await receiveTiles(file, listener, store, listener.tileRequest);
      begin = end;
      try {
        answer = await file.request(end, reader.head ? null : end + firstBytes);
      } catch (error) {
        if (error instanceof PastEnd) break; // the last range ended at the end of the file
        throw error;
      }
    }
    reader.finish();
  } catch (error) {
    // the file may have been replaced
    if (isInvalid(error) && begun.length && !reader?.head) return receiveFresh(file, listener, store);
    const rest = reader?.begun ?? { offset: 0, bytes: begun };
    keepBegun(file, error, rest, rest.offset ? 0 : begun.length);
    throw error;
  }
  if (store.complete) return "complete";
  if (!reader.head) throw new Damaged("the file ends before its side information does");
  throw missing(store);
}

/** Returns true for an error that says that the bytes do not belong to the stream. */
const isInvalid = (error: unknown): boolean => error instanceof Damaged || error instanceof PastEnd;

/** Keeps what has arrived of a head or packet before the connection broke or stalled, `known` bytes of it earlier. */
function keepBegun(file: HttpFile, error: unknown, { offset, bytes }: PacketReader["begun"], known: number): void {
  if (!isInvalid(error) && !(error instanceof RangeUnsupported)) file.keepBegun(offset, bytes, known);
}

/** Reads the missing packets of a file, run by run. Throws `Reordered` if they are not at the expected offsets. */
async function receiveGaps(file: HttpFile, listener: Listener, store: PacketStore): Promise<string> {
  const progress = new ProgressReporter(listener, store);
  progress.add(0);
  for (let before = -1; store.count > before; ) {
    before = store.count; // a server may return a shorter range than requested
    const { gaps } = store;
    if (store.isReordered) restart(file); // the cache may have offsets of two orders, which hide missing packets
    for (const gap of gaps) {
      if (listener.stopped()) return "stopped";
      await receiveGap(file, gap, listener, store, progress);
    }
  }
  if (store.complete) return "complete";
  if (store.isReordered) restart(file);
  throw missing(store);
}

/** Restarts without the known offsets. After too many restarts, the whole file is requested. */
function restart(file: HttpFile): never {
  checkOrder(file, false);
  throw new RangeUnsupported(`${file.name} has its packets in another order in every answer`);
}

/** Throws `Reordered` if packets are not at the expected offsets and a restart may help. */
function checkOrder(file: HttpFile, isContinuation: boolean): void {
  if (!isContinuation && ++file.reordered <= MAX_REORDERED) throw new Reordered();
}

/**
 * Reads one gap and the packet before it, which verifies the order of the file. A response with only that packet is
 * requested again once. The first packet of the gap is continued if it began to arrive.
 */
async function receiveGap(
  file: HttpFile,
  gap: Gap,
  listener: Listener,
  store: PacketStore,
  progress: ProgressReporter,
): Promise<void> {
  const continues = file.hasBegun(gap.offset),
    first = continues ? gap.offset : (gap.before ?? gap.offset),
    read = await readPart(file, gap, first, listener, store, progress);
  if (read.size) checkOrder(file, continues || isAsKnown(gap, store, read.reader));
  if (store.isReordered && !store.complete) restart(file);
  const isDone = store.complete || listener.stopped() || first === gap.offset || read.reader.numIntact > 1;
  if (!isDone && read.size && first + read.size < (gap.end ?? Infinity))
    await readPart(file, gap, gap.offset, listener, store, progress);
}

async function readPart(
  file: HttpFile,
  gap: Gap,
  begin: number,
  listener: Listener,
  store: PacketStore,
  progress: ProgressReporter,
): Promise<{ size: number; reader: PacketReader }> {
  const begun = file.takeBegun(begin, (gap.end ?? Infinity) - begin - 1),
    answer = await file.request(begin + begun.length, gap.end).catch((error: unknown) => {
      keepBegun(file, error, { offset: begin, bytes: begun }, begun.length);
      throw error;
    }),
    reader = new PacketReader(listener, store, answer.keep, store.head, begin);
  let size = 0;
  try {
    reader.feed(begun);
    for (let piece = await answer.read(); piece; piece = await answer.read()) {
      reader.feed(piece);
      progress.add(piece.length);
      size += piece.length;
      if (reader.numIntact) file.ranges = "usable";
      if (store.complete || listener.stopped()) return { size, reader };
    }
    reader.finish();
  } catch (error) {
    const rest = reader.begun;
    keepBegun(file, error, rest, rest.offset === begin ? begun.length : 0);
    if (!(error instanceof Damaged)) throw error;
    if (gap.end === null && !reader.numIntact) file.noteUseless(error.message);
    checkOrder(file, isAsKnown(gap, store, reader) || begin === gap.offset);
    if (gap.end === null) throw error;
  } finally {
    answer.cancel();
  }
  return { size, reader };
}

/** Returns true if the packet before a gap is at the expected offset. */
function isAsKnown({ before }: Gap, store: PacketStore, { first }: PacketReader): boolean {
  return before === null || (first !== null && first.position === before && store.isAt(before, first.bytes));
}

/** Reads the whole file with one request and skips the stored packets. */
async function receiveWhole(file: HttpFile, listener: Listener, store: PacketStore): Promise<string> {
  const answer = await file.request(null);
  try {
    const ended = await readAll(answer, listener, store, new ProgressReporter(listener, store));
    if (ended) return ended;
  } finally {
    answer.cancel();
  }
  throw missing(store);
}

/** Reads a stream that is embedded in the page. */
export async function receiveBytes(
  bytes: Uint8Array<ArrayBuffer>,
  listener: Listener,
  store: PacketStore,
): Promise<string> {
  const stream = new Response(bytes).body!.getReader(),
    read = async (): Promise<Uint8Array | null> => (await stream.read()).value ?? null,
    answer = { offset: 0, whole: true, total: bytes.length, keep: false, read, cancel: () => undefined };
  try {
    return (
      (await readAll(answer, listener, store, new ProgressReporter(listener, store, "in this file"))) ??
      missingIn(store)
    );
  } catch (error) {
    if (!(error instanceof Damaged) || !store.hasHead) throw (error as Error).cause ?? error;
    return error.message;
  }
}

/** Reads a response that begins with the file. Returns how it ended, or null if packets are missing. */
async function readAll(
  answer: Answer,
  listener: Listener,
  store: PacketStore,
  progress: ProgressReporter,
): Promise<string | null> {
  const reader = new PacketReader(listener, store, answer.keep);
  for (let piece = await answer.read(); piece; piece = await answer.read()) {
    if (listener.stopped()) return "stopped";
    reader.feed(piece);
    progress.add(piece.length);
    if (reader.head && store.complete) return "complete";
  }
  if (!reader.head) throw new Damaged("the file ends before its side information does");
  reader.finish();
  return store.complete ? "complete" : null;
}

/** Returns the error for missing packets. Stored ones may belong to another version of the stream. */
function missing(store: PacketStore): Error {
  return store.conflicts ? new FileReplaced() : new Damaged(missingIn(store));
}

function missingIn({ head, count }: PacketStore): string {
  const missing = (head?.manifest.numPackets ?? 0) - count;
  return `${missing} ${missing === 1 ? "packet is" : "packets are"} damaged or not in the file`;
}
