// The receiving worker in tests of the package, instead of `worker:receiver`. Tests send its messages.

import type { FromWorker, ToWorker } from "../src/transport/messages.ts";

export class FakeWorker extends EventTarget {
  static last: FakeWorker | null = null;
  readonly requests: ToWorker[] = [];
  isTerminated = false;

  constructor() {
    super();
    FakeWorker.last = this;
  }

  postMessage(message: ToWorker): void {
    this.requests.push(message);
  }

  terminate(): void {
    this.isTerminated = true;
  }

  /** Sends a message to the page. */
  send(data: FromWorker): void {
    this.dispatchEvent(new MessageEvent("message", { data }));
  }
}

export default (): Worker => new FakeWorker() as unknown as Worker;

export const notStarted = "the worker did not start";
