// What the panel says of packets.

import type { FromWorker } from "../transport/messages.ts";
import type { Panel } from "./panel.ts";

export function tellCounts(panel: Panel, { counts, decodeMs, corrupt }: FromWorker & { kind: "counts" }): void {
  const { packets, expected, bytes, seconds, lost, way } = counts,
    damaged = corrupt ? `, ${corrupt} damaged` : "";
  panel.progress(expected ? packets / expected : 0);
  panel.tell("packets", `${packets.toLocaleString()} of ${expected.toLocaleString()}${damaged}`);
  panel.tell("missing", expected > packets ? `${(expected - packets).toLocaleString()} packets` : "none");
  panel.tell("received", `${(bytes / 1e6).toFixed(2)} MB`);
  panel.tell("rate", seconds > 0 ? `${((bytes * 8) / 1e6 / seconds).toFixed(1)} Mbit/s` : "-");
  panel.tell("lost on the way", lost ? `${lost} datagrams` : "none");
  panel.tell("time", `${seconds.toFixed(2)} s`);
  panel.tell("decoding", `${(decodeMs / 1000).toFixed(2)} s`);
  panel.tell("way", way);
}
