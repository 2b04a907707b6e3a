// HTTP errors.

/** Upper bound of the delay that a server may request with `Retry-After`, milliseconds. */
const MAX_WAIT_MS = 60_000;

/** Returns the address for messages: without its query, which may have a token. */
export const withoutQuery = (url: string): string => url.split("?")[0];

/** Error for an HTTP error status. `final` is true if a retry cannot help. */
export class HttpError extends Error {
  readonly final: boolean;
  /** Delay requested by the server before the next attempt, milliseconds; 0 if none. */
  readonly retryMs: number;

  constructor(url: string, { status, statusText, headers }: Response) {
    super(`${withoutQuery(url)} answers ${status} ${statusText}`.trim());
    this.final = status >= 400 && status < 500 && ![408, 425, 429].includes(status);
    const ms = retryDelay(headers.get("retry-after") ?? "");
    this.retryMs = ms > 0 ? Math.min(ms, MAX_WAIT_MS) : 0;
  }
}

/** Returns true for an error that a retry cannot resolve. */
export const isFinal = (error: unknown): boolean => (error as { final?: boolean } | null)?.final === true;

/**
 * Error if the browser withholds a server's responses from the page (CORS). A retry may help, because proxies send
 * their own errors, such as 502, without the header.
 */
export class Unreadable extends Error {
  constructor(url: string) {
    super(
      `the server of ${withoutQuery(url)} answers, but this page may not read it: the file or its redirect needs ` +
        "the header Access-Control-Allow-Origin (CORS), unless the server failed",
    );
  }
}

/** Returns the delay of a `Retry-After` header, seconds or a date, in milliseconds; NaN if it is invalid. */
function retryDelay(header: string): number {
  return /^\d+$/.test(header) ? 1000 * Number(header) : Date.parse(header) - Date.now();
}
