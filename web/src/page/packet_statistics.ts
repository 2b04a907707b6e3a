// Packet statistics and metadata in the panel.

import type { FromWorker, StreamInfo } from "../transport/messages.ts";
import type { Panel } from "./panel.ts";

export function showPacketStatistics(
  panel: Panel,
  { counts, decodeMs, corrupt }: FromWorker & { kind: "counts" },
): void {
  const { packets, expected, bytes, seconds, lost, transport } = counts,
    damaged = corrupt ? `, ${corrupt} damaged` : "";
  panel.progress(expected ? packets / expected : 0);
  panel.setRow("packets", `${packets.toLocaleString()} of ${expected.toLocaleString()}${damaged}`);
  panel.setRow("missing", expected > packets ? `${(expected - packets).toLocaleString()} packets` : "none");
  panel.setRow("received", `${(bytes / 1e6).toFixed(2)} MB`);
  panel.setRow("rate", seconds > 0 ? `${((bytes * 8) / 1e6 / seconds).toFixed(1)} Mbit/s` : "-");
  panel.setRow("datagrams lost", `${lost || "none"}`);
  panel.setRow("time", `${seconds.toFixed(2)} s`);
  panel.setRow("decoding", `${(decodeMs / 1000).toFixed(2)} s`);
  panel.setRow("transport", transport);
}

/**
 * Shows the texts of a scene, and its origin if it is georeferenced. The title is shown in the bar unless the page
 * names the scene itself (`isNamed`).
 */
export function showMetadata(panel: Panel, { texts, origin }: StreamInfo, isNamed: boolean): void {
  if (texts.title && !isNamed) panel.title = texts.title;
  panel.setRow("title", texts.title, true);
  panel.setRow("author", texts.author, true);
  panel.setRow("license", texts.license, true);
  panel.setRow("origin", origin.some((value) => value !== 0) ? origin.join(", ") : "", true);
}
