// Answers of a server that have no content.

/** Longest wait that a server may request with `Retry-After`, milliseconds. */
const MAX_WAIT_MS = 60_000;

/** An HTTP error status. `final` is True if another attempt cannot help. */
export class Refused extends Error {
  readonly final: boolean;
  /** Wait before the next attempt that the server requests, milliseconds; 0 if it requests none. */
  readonly retryMs: number;

  constructor(url: string, { status, statusText, headers }: Response) {
    super(`${url} answers ${status} ${statusText}`.trim());
    this.final = status >= 400 && status < 500 && status !== 408 && status !== 425 && status !== 429;
    const seconds = Number(headers.get("retry-after"));
    this.retryMs = seconds > 0 ? Math.min(1000 * seconds, MAX_WAIT_MS) : 0;
  }
}
