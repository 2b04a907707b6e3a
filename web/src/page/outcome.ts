// How the reception of a stream goes and ends: kept in the status, said in the panel, told to the page around.

import type { Status, Tell } from "./events.ts";
import type { Panel } from "./panel.ts";

export class Outcome {
  #drops = 0;
  #digests: ((same: boolean) => void)[] = [];

  constructor(
    readonly status: Status,
    readonly panel: Panel,
    readonly tell: Tell,
  ) {}

  /** It cannot go on. */
  fail(text: string): void {
    this.status.failed = text;
    this.panel.say(text, "bad");
    this.tell("error", { message: text });
  }

  /** The link dropped. */
  lost(reason: string, retryMs: number): void {
    this.status.lost = reason;
    this.panel.tell("link", `dropped ${++this.#drops === 1 ? "once" : `${this.#drops} times`}: ${reason}`);
    this.panel.say(`The link dropped (${reason}); trying again in ${Math.round(retryMs / 1000) || 1} s.`, "bad");
    this.tell("lost", { reason, retryMs });
  }

  /** Packets come, of what is `live` or not. */
  progress(live: boolean): void {
    const { status, panel } = this,
      { packets, expected } = status;
    if (status.lost && !status.finished) status.lost = null;
    if (packets && expected && !status.finished && !status.failed) panel.say(live ? "Live." : "Receiving ...");
  }

  /** No more packets come; `text` says how it ended. */
  finished(text: string, complete: boolean, live: boolean): void {
    const { status, panel } = this;
    status.finished = text;
    status.complete = complete;
    status.lost = null;
    if (status.failed) return;
    if (live)
      panel.say(text === "complete" || text === "sent" ? "The live clip has ended." : `The live clip ended: ${text}.`);
    else if (complete) return panel.say("Everything came; it is being checked.");
    else panel.say(`It ended early: ${text}. What is missing is concealed.`);
    this.tell("load", { complete, verified: false });
  }

  /** All integers were decoded, and are those that were encoded or not. */
  verified(same: boolean): void {
    const { status } = this;
    for (const resolve of this.#digests.splice(0)) resolve(same);
    if (!status.complete || status.verified !== null) return;
    status.verified = same;
    if (!same) this.fail("Everything came, and it is not what was encoded: the stream was altered or is damaged.");
    else if (!status.failed) this.panel.say("Everything is there.", "done");
    this.tell("load", { complete: true, verified: same });
  }

  /** Whether the integers are those that were encoded, once that is known; `ask` has it found out. */
  verify(ask: () => void): Promise<boolean> {
    if (this.status.verified !== null) return Promise.resolve(this.status.verified);
    ask();
    return new Promise((resolve) => this.#digests.push(resolve));
  }
}
