// Tiles of a scene with levels, fetched from any file server by ranges of bytes, in the order in which a view wants
// them.

import { ContainerReader } from "../packets/container.ts";
import type { Arrived, Fetching, Listener } from "./events.ts";
import type { Held } from "./held.ts";
import { type HttpFile, readBytes } from "./http_file.ts";
import { isIntact } from "./packet_reader.ts";

/** Requests at a time: one is answered while the next one is on its way. */
const AT_ONCE = 2;
/** How often a tile that comes damaged is requested. */
const MAX_TRIES = 3;
const WAY = "HTTP, by ranges";

/** Tiles came damaged, or the file was replaced. */
export class DamagedTiles extends Error {}

/**
 * Fetches what the view wants, whatever it turns to, until everything is there; returns the words for how it ended.
 * A tile that stays damaged is left out. Throws where the connection breaks, or the server refuses or gives no ranges,
 * and `DamagedTiles` before a tile is requested again.
 */
export async function receiveTiles(file: HttpFile, listener: Listener, held: Held, view: Fetching): Promise<string> {
  const { head } = view,
    aborted = new AbortController(),
    requested = new Set<number>(),
    began = performance.now(),
    expected = head.manifest.numPackets,
    begin = held.headBytes;
  let bytes = 0;
  const tell = (): void =>
    listener.counts({
      way: WAY,
      bytes,
      packets: view.packets,
      expected,
      lost: 0,
      rejected: 0,
      seconds: (performance.now() - began) / 1000,
    });
  const triesOf = (tile: number): number => file.damagedTiles.get(tile) ?? 0,
    isGivenUp = (tile: number): boolean => triesOf(tile) >= MAX_TRIES;
  const busy = new Set<Promise<void>>();
  const start = (run: Run): void => {
    const work = fetchRun(run).finally(() => busy.delete(work));
    work.catch(() => undefined); // whoever waits for it gets the error
    busy.add(work);
  };
  const fetchRun = async (run: Run): Promise<void> => {
    const tiles = Array.from({ length: run.end - run.first }, (_, n) => run.first + n),
      { offsets } = view.tiles;
    let end = 0;
    for (const tile of tiles) requested.add(tile);
    try {
      const size = offsets[run.end] - offsets[run.first],
        from = begin + offsets[run.first],
        cache = tiles.some(triesOf) ? "reload" : file.cache,
        piece = await readBytes(await file.request(from, from + size, cache, aborted.signal), size),
        packets = tiles.flatMap((tile) => intactPackets(piece, tile, run, view));
      bytes += piece.length;
      end = offsets[run.first] + piece.length;
      if (packets.length) {
        [file.ranges, file.useless] = ["usable", 0];
        listener.packets(packets);
      }
      tell();
      await view.taken();
      if (!packets.length) file.noteUseless(`${file.url} answers with other bytes than were requested`);
    } finally {
      for (const tile of tiles) requested.delete(tile);
    }
    // tiles behind the end of a short answer are requested once more, like all that the view wants
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
    await view.taken();
    while (!listener.stopped() && remaining() > 0) {
      const isFree = (tile: number): boolean => !requested.has(tile) && !isGivenUp(tile),
        run = busy.size < AT_ONCE ? nextRun(view, isFree, file.limits.tilesBytes) : null;
      if (run) start(run);
      else if (busy.size) await Promise.race(busy);
      else {
        tell();
        await view.moved(isGivenUp);
      }
    }
  } finally {
    aborted.abort();
  }
  tell();
  if (view.packets >= expected) return "complete";
  return listener.stopped() ? "stopped" : `${expected - view.packets} packets are damaged on the server`;
}

interface Run {
  readonly first: number;
  readonly end: number;
}

/** Tiles next to one another that are wanted, the most useful and what lies behind it in the file. */
function nextRun({ tiles, wanted }: Fetching, isFree: (tile: number) => boolean, most: number): Run | null {
  const free = wanted.filter(isFree);
  if (!free.length) return null;
  const some = new Set(free),
    first = free[0];
  let end = first + 1;
  while (some.has(end) && tiles.offsets[end + 1] - tiles.offsets[first] <= most) end++;
  return { first, end };
}

/** Intact packets of a tile, out of the bytes of its run. */
function intactPackets(piece: Uint8Array, tile: number, run: Run, { tiles, head }: Fetching): Arrived[] {
  const { offsets, firstPackets } = tiles,
    begin = offsets[run.first],
    bytes = piece.subarray(offsets[tile] - begin, offsets[tile + 1] - begin),
    count = firstPackets[tile + 1] - firstPackets[tile];
  return new ContainerReader(head)
    .feed(bytes)
    .slice(0, count)
    .map((packet, n) => ({ place: firstPackets[tile] + n, bytes: packet }))
    .filter((packet) => isIntact(packet.bytes, head));
}
