// Tiles of a scene with levels, fetched from any file server by ranges of bytes, in the order in which a view wants
// them.

import { ContainerReader } from "../packets/container.ts";
import type { Fetching, Listener } from "./events.ts";
import { Refused } from "./refused.ts";

/** Bytes of a request: enough that the way there and back costs little, few enough that who turns is soon served. */
const REQUEST_BYTES = 1 << 16;
/** Requests at a time: one is answered while the next one is on its way. */
const AT_ONCE = 2;
const WAY = "HTTP, by ranges";

/** The server gives no ranges. */
export class NoRanges extends Error {}

/**
 * Fetches what the view wants, whatever it turns to, until everything is there. `begin` is where packets begin in the
 * file. Throws where the connection breaks, or the server refuses or gives no ranges.
 */
export async function receiveTiles(
  url: string,
  listener: Listener,
  begin: number,
  view: Fetching,
  most = REQUEST_BYTES,
): Promise<string> {
  const { head } = view,
    aborted = new AbortController(),
    asked = new Set<number>(),
    began = performance.now(),
    expected = head.manifest.numPackets;
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
  const busy = new Set<Promise<void>>();
  const start = (run: Run): void => {
    const work = fetchRun(run).finally(() => busy.delete(work));
    work.catch(() => undefined); // whoever waits for it hears of it
    busy.add(work);
  };
  const fetchRun = async (run: Run): Promise<void> => {
    for (let tile = run.first; tile < run.end; tile++) asked.add(tile);
    try {
      const { offsets, firstPackets } = view.tiles,
        headers = { Range: `bytes=${begin + offsets[run.first]}-${begin + offsets[run.end] - 1}` },
        answer = await fetch(url, { headers, signal: aborted.signal });
      if (answer.status === 200) throw new NoRanges();
      if (answer.status !== 206) throw new Refused(url, answer);
      const piece = new Uint8Array(await answer.arrayBuffer()),
        packets = new ContainerReader(head).feed(piece);
      bytes += piece.length;
      listener.packets(packets.map((packet, n) => ({ place: firstPackets[run.first] + n, bytes: packet })));
      tell();
      await view.taken();
    } finally {
      for (let tile = run.first; tile < run.end; tile++) asked.delete(tile);
    }
    if (view.wanted.some((tile) => tile >= run.first && tile < run.end)) throw new Error("a tile is damaged");
  };
  try {
    await view.taken();
    while (!listener.stopped() && view.packets < expected) {
      const run = busy.size < AT_ONCE ? nextRun(view, asked, most) : null;
      if (run) start(run);
      else if (busy.size) await Promise.race(busy);
      else {
        tell();
        await view.moved();
      }
    }
  } finally {
    aborted.abort();
  }
  return view.packets < expected ? "stopped" : "complete";
}

interface Run {
  readonly first: number;
  readonly end: number;
}

/** Tiles next to one another that are wanted, the most useful and what lies behind it in the file. */
function nextRun({ tiles, wanted }: Fetching, asked: Set<number>, most: number): Run | null {
  const free = wanted.filter((tile) => !asked.has(tile));
  if (!free.length) return null;
  const some = new Set(free),
    first = free[0];
  let end = first + 1;
  while (some.has(end) && tiles.offsets[end + 1] - tiles.offsets[first] <= most) end++;
  return { first, end };
}
