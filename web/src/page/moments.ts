// When something was on the screen for the first time.

import type { Status, Tell } from "./events.ts";

export class Moments {
  /** Nothing is told once `over` says so. */
  constructor(
    readonly status: Status,
    readonly tell: Tell,
    readonly over: AbortSignal,
  ) {}

  /** What has this name comes to the screen when `shown` resolves; the first time counts. */
  soon(name: string, shown: () => Promise<void>): void {
    if (name in this.status.times) return;
    this.status.times[name] = NaN;
    void shown().then(() => this.seen(name));
  }

  /** What has this name is on the screen. */
  seen(name: string): void {
    const { times, began } = this.status,
      first = !Object.values(times).some((ms) => ms > 0);
    if (times[name] > 0 || this.over.aborted) return;
    const ms = (times[name] = performance.now() - began);
    if (first) this.tell("firstpicture", { ms, preview: name === "preview" });
  }
}
