// Tiles of a scene with levels, fetched by range requests in the order of the view.

import { readPacket } from "../packets/packet.ts";
import type { Listener, ReceivedPacket, TileRequest } from "./events.ts";
import { type HttpFile, readRange } from "./http_file.ts";
import { PacketScanner } from "./packet_reader.ts";
import type { PacketStore } from "./packet_store.ts";
import { ProgressReporter } from "./progress_reporter.ts";

/** Largest number of concurrent requests. */
const MAX_REQUESTS = 2;
/** Largest number of requests for a tile that arrives damaged. */
const MAX_TRIES = 3;
const RANGE_REQUESTS = "HTTP, by ranges";

/** Error for damaged tiles or a replaced file. */
export class DamagedTiles extends Error {}

/** Error for a file with another order of tiles than the stream's index. */
export class OtherOrder extends Error {}

/**
 * Receives the tiles of the view, through all its changes, until the stream is complete. Returns how it ended.
 *
 * A tile that arrives damaged repeatedly is postponed to the end. Throws if the connection breaks, the server refuses
 * or has no range requests. Throws `DamagedTiles` before a tile is requested again, and `OtherOrder` if packets must be
 * searched in the whole file.
 */
export async function receiveTiles(
  file: HttpFile,
  listener: Listener,
  store: PacketStore,
  view: TileRequest,
): Promise<string> {
  const { head } = view,
    aborted = new AbortController(),
    requested = new Set<number>(),
    expected = head.manifest.numPackets,
    begin = store.headSize,
    progress = new ProgressReporter(listener, store, RANGE_REQUESTS),
    triesOf = (tile: number): number => file.damagedTiles.get(tile) ?? 0,
    isGivenUp = (tile: number): boolean => triesOf(tile) >= MAX_TRIES;
  const busy = new Set<Promise<void>>();
  const start = (run: Run): void => {
    const work = fetchRun(run).finally(() => busy.delete(work));
    work.catch(() => undefined); // the awaiting code handles the error
    busy.add(work);
  };
  const fetchRun = async (run: Run): Promise<void> => {
    const tiles = Array.from({ length: run.end - run.first }, (_, n) => run.first + n),
      { offsets } = view.tiles;
    let end = 0,
      hasForeign = false;
    for (const tile of tiles) requested.add(tile);
    try {
      const size = offsets[run.end] - offsets[run.first],
        from = begin + offsets[run.first],
        cache = tiles.some(triesOf) ? "reload" : file.cache,
        minBytes = offsets[run.first + 1] - offsets[run.first],
        piece = await readRange(file, from, from + size, minBytes, cache, aborted.signal),
        packets = tiles.flatMap((tile) => intactPackets(piece, tile, run, begin, view));
      end = offsets[run.first] + piece.length;
      hasForeign = packets.some(({ bytes: one }) => !isOfTiles(one, run, view));
      if (packets.length) {
        [file.ranges, file.useless] = ["usable", 0];
        listener.packets(packets);
      }
      progress.add(piece.length);
      await view.decoded();
      if (!packets.length) file.noteUseless(`${file.name} answers with other bytes than were requested`);
    } finally {
      for (const tile of tiles) requested.delete(tile);
    }
    // tiles after the end of a short response are requested again with the other missing tiles
    if (hasForeign) throw new OtherOrder(`${file.name} has other tiles than were requested`);
    const damaged = tiles.filter((tile) => view.missing(tile) && (tile === run.first || offsets[tile + 1] <= end));
    for (const tile of damaged) file.damagedTiles.set(tile, triesOf(tile) + 1);
    if (damaged.length) throw new DamagedTiles(`${damaged.length} tiles came damaged`);
  };
  const remaining = (): number => {
    let givenUp = 0;
    for (const tile of file.damagedTiles.keys()) if (isGivenUp(tile)) givenUp += view.missing(tile);
    return expected - view.packets - givenUp;
  };
  try {
    await view.decoded();
    while (!listener.stopped() && remaining() > 0) {
      const isFree = (tile: number): boolean => !requested.has(tile) && !isGivenUp(tile),
        run = busy.size < MAX_REQUESTS ? nextRun(view, isFree, file.limits.tilesBytes) : null;
      if (run) start(run);
      else if (busy.size) await Promise.race(busy);
      else {
        progress.add(0);
        await view.nextView(isGivenUp);
      }
    }
  } finally {
    aborted.abort();
  }
  progress.add(0);
  if (view.packets >= expected) return "complete";
  if (listener.stopped()) return "stopped";
  throw new OtherOrder(`${expected - view.packets} packets are not where the index of the stream has them`);
}

interface Run {
  readonly first: number;
  readonly end: number;
}

/** Returns a run of adjacent missing tiles, beginning with the most useful one. */
function nextRun({ tiles, wanted }: TileRequest, isFree: (tile: number) => boolean, maxBytes: number): Run | null {
  const free = wanted.filter(isFree);
  if (!free.length) return null;
  const freeTiles = new Set(free),
    first = free[0];
  let end = first + 1;
  while (freeTiles.has(end) && tiles.offsets[end + 1] - tiles.offsets[first] <= maxBytes) end++;
  return { first, end };
}

/**
 * Returns the intact packets of a tile, given the bytes of its run. `begin` is the offset of the first tile in the
 * file.
 */
function intactPackets(piece: Uint8Array, tile: number, run: Run, begin: number, view: TileRequest): ReceivedPacket[] {
  const { offsets } = view.tiles,
    first = offsets[run.first],
    bytes = piece.subarray(offsets[tile] - first, offsets[tile + 1] - first);
  return new PacketScanner(view.head, begin + offsets[tile]).feed(bytes, true);
}

/** Returns true if a packet belongs to one of the tiles of a run. */
function isOfTiles(bytes: Uint8Array, run: Run, { head }: TileRequest): boolean {
  const { block } = readPacket(bytes, head.manifest.streamId)!;
  return run.first <= block && block < run.end;
}
