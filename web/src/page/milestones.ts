// Milestones: when a picture was first on the screen.

import type { Dispatch, Status } from "./events.ts";

export class Milestones {
  /** No event is sent after `released` is aborted. */
  constructor(
    readonly status: Status,
    readonly dispatch: Dispatch,
    readonly released: AbortSignal,
  ) {}

  /** Records milestone `name` once `shown` resolves. Only the first call counts. */
  recordWhen(name: string, shown: () => Promise<void>): void {
    if (name in this.status.times) return;
    this.status.times[name] = NaN;
    void shown().then(() => this.record(name));
  }

  /** Records that milestone `name` is on the screen now. */
  record(name: string): void {
    const { times, began } = this.status,
      first = !Object.values(times).some((ms) => ms > 0);
    if (times[name] > 0 || this.released.aborted) return;
    const ms = (times[name] = performance.now() - began);
    if (first) this.dispatch("firstpicture", { ms, preview: name === "preview" });
  }
}
