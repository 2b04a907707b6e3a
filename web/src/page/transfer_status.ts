// State of a transfer, reported in the status, in the panel and as events.

import type { Dispatch, Status } from "./events.ts";
import type { Panel } from "./panel.ts";

export class TransferStatus {
  #disconnects = 0;
  /** Error before the present one, which may be withdrawn. */
  #earlierError: string | null = null;
  #digestWaiters: ((isVerified: boolean) => void)[] = [];

  constructor(
    readonly status: Status,
    readonly panel: Panel,
    readonly dispatch: Dispatch,
  ) {}

  /** Reports an error (see the event `error`); `withdraw` takes it back. */
  fail(text: string): void {
    const { status } = this;
    if (status.failed !== text) this.#earlierError = status.failed;
    status.failed = text;
    this.panel.setMessage(text, "bad");
    if (!status.gaussians) this.panel.showNotice("error", text);
    this.dispatch("error", { message: text });
  }

  /** Withdraws an error that is over. An earlier error stays. */
  withdraw(text: string): void {
    if (this.status.failed !== text) return;
    this.status.failed = this.#earlierError;
    this.panel.setMessage(this.#earlierError ?? "", "bad");
  }

  /** Reports a disconnect. */
  lost(reason: string, retryMs: number): void {
    this.status.lost = reason;
    this.panel.setRow(
      "link",
      `dropped ${++this.#disconnects === 1 ? "once" : `${this.#disconnects} times`}: ${reason}`,
    );
    const text = `Connection lost (${reason}); next attempt in ${Math.round(retryMs / 1000) || 1} s.`;
    this.panel.setMessage(text, "bad");
    if (!this.status.gaussians) this.panel.showNotice("offline", navigator.onLine ? text : `You are offline. ${text}`);
    this.dispatch("lost", { reason, retryMs });
  }

  /**
   * Reports progress. `droppedGroups` is the number of groups of frames of a live clip's current period that this
   * device was too slow for.
   */
  progress(live: boolean, droppedGroups = 0): void {
    const { status, panel } = this,
      { packets, expected } = status;
    if (status.lost && !status.finished) status.lost = null;
    if (!packets || !expected || status.finished || status.failed) return;
    const dropped = droppedGroups ? ` This device is too slow; dropped groups: ${droppedGroups}.` : "";
    panel.setMessage(live ? `Live.${dropped}` : "Receiving ...");
    if (!status.gaussians) panel.showNotice("loading", "Receiving ...");
  }

  /** Reports the end of the transfer. */
  finished(outcome: string, complete: boolean, live: boolean): void {
    const { status, panel } = this;
    status.finished = outcome;
    status.complete = complete;
    status.lost = null;
    const checking = complete && !live;
    if (!status.failed)
      panel.setMessage(
        checking
          ? "All packets received; checking them."
          : !live
            ? `The transfer ended early: ${outcome}. Missing packets are concealed.`
            : outcome === "complete" || outcome === "sent"
              ? "The live clip has ended."
              : `The live clip ended: ${outcome}.`,
      );
    if (!checking) this.dispatch("load", { complete, verified: false });
  }

  /** Reports the result of the digest check. */
  verified(isVerified: boolean): void {
    const { status } = this;
    for (const resolve of this.#digestWaiters.splice(0)) resolve(isVerified);
    if (!status.complete || status.verified !== null) return;
    status.verified = isVerified;
    if (!isVerified) this.fail("All packets arrived, but their digest is wrong: the stream is altered or damaged.");
    else if (!status.failed) this.panel.setMessage("Complete and verified.", "done");
    this.dispatch("load", { complete: true, verified: isVerified });
  }

  /** Resolves to the result of the digest check. `start` is called if no check has run yet. */
  verify(start: () => void): Promise<boolean> {
    if (this.status.verified !== null) return Promise.resolve(this.status.verified);
    start();
    return new Promise((resolve) => this.#digestWaiters.push(resolve));
  }
}
