// Tiles by range requests: in the order of the view, resumed after a disconnect, and not from a server without ranges.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createServer, type RequestListener } from "node:http";
import type { AddressInfo } from "node:net";
import { test } from "node:test";

import type { Camera } from "../src/model/camera.ts";
import { ContainerReader } from "../src/packets/container.ts";
import { DecodedStream } from "../src/transport/decoded_stream.ts";
import type { Listener, TileRequest } from "../src/transport/events.ts";
import { HttpFile, RangeUnsupported } from "../src/transport/http_file.ts";
import { PacketStore, SIZE_BYTES } from "../src/transport/packet_store.ts";
import { DamagedTiles, receiveTiles } from "../src/transport/tiles.ts";
import { packetOffsets } from "./fake_web.ts";

const file = new Uint8Array(readFileSync("../tests/golden/tiny_levels.swz"));
const LIMITS = { idleMs: 8000, fastBytes: 100, repeatMs: 1, firstBytes: 4000, tilesBytes: 2000, changeMs: 60_000 };
const LOOK: Camera = {
  viewmat: [
    [1, 0, 0, -3],
    [0, 1, 0, 7],
    [0, 0, 1, 3],
    [0, 0, 0, 1],
  ],
  focal: 800,
  width: 400,
  height: 300,
  margin: 0,
};

/** A view that stays until its tiles arrived, then selects every tile. */
function visitor(): { listener: Listener; view: TileRequest; store: PacketStore; places: number[] } {
  const container = new ContainerReader(),
    store = new PacketStore(),
    places: number[] = [];
  container.feed(file);
  const head = container.head!,
    received = new DecodedStream(head),
    { tiling } = received.decoder.elementDecoder;
  assert.ok(tiling);
  store.begin(container.headBytes, head);
  tiling.setCamera(LOOK);
  const listener: Listener = {
    preview: () => undefined,
    head: () => undefined,
    packets: (some) => {
      for (const { position, bytes } of some) {
        places.push(position);
        received.addPacket(bytes);
      }
    },
    counts: () => undefined,
    stopped: () => false,
  };
  const view: TileRequest = {
    head,
    tiles: tiling.tiles,
    get wanted() {
      return tiling.wanted;
    },
    get packets() {
      return received.decoder.intake.size;
    },
    missing: (tile) => tiling.tiles.numPackets[tile] - (received.decoder.intake.blocks.get(tile)?.length ?? 0),
    nextView: () => Promise.resolve(void tiling.setCamera(null)),
    decoded: () => Promise.resolve(void tiling.setCamera(LOOK)),
  };
  return { listener, view, store, places };
}

async function served(answer: RequestListener, work: (url: string) => Promise<void>): Promise<void> {
  const server = createServer(answer).listen(0, "127.0.0.1");
  try {
    await new Promise((resolve) => server.once("listening", resolve));
    await work(`http://127.0.0.1:${(server.address() as AddressInfo).port}/a.swz`);
  } finally {
    server.closeAllConnections();
    server.close();
  }
}

const ranged: RequestListener = ({ headers }, answer) => {
  const [, from, to] = /bytes=(\d+)-(\d+)/.exec(headers.range ?? "")!;
  answer.writeHead(206).end(file.subarray(Number(from), Number(to) + 1));
};

test("all tiles are received, the view's first", async () => {
  const { listener, view, store, places } = visitor(),
    first = view.wanted[0];
  await served(ranged, async (url) => {
    assert.equal(await receiveTiles(new HttpFile(url, LIMITS), listener, store, view), "complete");
  });
  assert.equal(places[0], store.headSize + view.tiles.offsets[first]);
  assert.deepEqual(
    [...places].sort((a, b) => a - b),
    packetOffsets(file).map((offset) => offset - SIZE_BYTES),
  );
});

test("no tile is transferred twice after a disconnect", async () => {
  const { listener, view, store, places } = visitor();
  let answers = 0;
  const failing: RequestListener = (request, answer) =>
    ++answers > 1 ? void request.socket.destroy() : ranged(request, answer);
  await served(failing, async (url) => {
    await assert.rejects(receiveTiles(new HttpFile(url, LIMITS), listener, store, view));
  });
  const before = places.length;
  assert.ok(before > 0 && before < view.head.manifest.numPackets);
  await served(ranged, async (url) => {
    assert.equal(await receiveTiles(new HttpFile(url, LIMITS), listener, store, view), "complete");
  });
  assert.equal(new Set(places).size, places.length);
});

test("a server without ranges and a damaged tile throw different errors", async () => {
  const { listener, view, store } = visitor();
  await served(
    (_, answer) => void answer.writeHead(200).end(file),
    async (url) => {
      await assert.rejects(receiveTiles(new HttpFile(url, LIMITS), listener, store, view), RangeUnsupported);
    },
  );
  await served(
    (_, answer) => void answer.writeHead(206).end(new Uint8Array(500)),
    async (url) => {
      await assert.rejects(receiveTiles(new HttpFile(url, LIMITS), listener, store, view), DamagedTiles);
    },
  );
});
