// Retries a failing transfer with exponential backoff.

const INITIAL_MS = 500,
  MAX_MS = 15_000;

export interface BackoffOptions {
  /** Returns true if a retry may succeed. */
  readonly isRetryable: (error: unknown) => boolean;
  /** Returns a number that grows with the received packets. Progress resets the backoff. */
  readonly progress: () => number;
  /** Called with the reason and the delay before each retry. */
  readonly disconnected: (reason: string, retryMs: number) => void;
  readonly wait: (ms: number) => Promise<void>;
}

/**
 * Repeats an attempt until it succeeds. Throws errors that a retry cannot resolve. `attempt` gets the delay before the
 * next attempt, milliseconds. An error with `waited` has spent that delay already.
 */
export async function withBackoff<T>(
  attempt: (nextMs: number) => Promise<T>,
  { isRetryable, progress, disconnected, wait }: BackoffOptions,
): Promise<T> {
  for (let failures = 0; ; failures++) {
    const before = progress(),
      nextMs = (): number => Math.min(INITIAL_MS * 2 ** failures, MAX_MS);
    try {
      return await attempt(nextMs());
    } catch (error) {
      if (!isRetryable(error)) throw error;
      if (progress() > before) failures = 0;
      const { retryMs = 0, waited } = error as { retryMs?: number; waited?: boolean }, // requested by the server
        ms = Math.max(waited ? 0 : nextMs(), retryMs);
      disconnected(reasonOf(error as Error), ms);
      await wait(ms);
    }
  }
}

/** Returns the message of an error. Node's `fetch failed` has the reason, such as an unknown host, in its cause. */
function reasonOf({ message, cause }: Error): string {
  const { message: reason = "", code = "" } = (cause ?? {}) as { message?: string; code?: string };
  return reason || code ? `${message}: ${reason || code}` : message;
}

/** Waits, or returns earlier when the browser is online again. */
export function waitOrOnline(ms: number): Promise<void> {
  return new Promise((resolve) => {
    const go = (): void => {
      clearTimeout(timer);
      globalThis.removeEventListener?.("online", go);
      resolve();
    };
    const timer = setTimeout(go, ms);
    globalThis.addEventListener?.("online", go); // not available in node
  });
}
