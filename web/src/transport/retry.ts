// Repeats a transfer that breaks, after a growing wait.

const FIRST_MS = 500,
  MOST_MS = 15_000;

export interface Retrying {
  /** Whether trying again could help. */
  readonly helps: (error: unknown) => boolean;
  /** Grows with what has arrived: after progress the waits begin anew. */
  readonly progress: () => number;
  /** Told why, and how long it waits. */
  readonly lost: (reason: string, retryMs: number) => void;
  readonly wait: (ms: number) => Promise<void>;
}

/** Attempts something until it succeeds. Throws what no further attempt could change. */
export async function retrying<T>(attempt: () => Promise<T>, { helps, progress, lost, wait }: Retrying): Promise<T> {
  for (let failures = 0; ; failures++) {
    const before = progress();
    try {
      return await attempt();
    } catch (error) {
      if (!helps(error)) throw error;
      if (progress() > before) failures = 0;
      const least = (error as { retryMs?: number }).retryMs ?? 0, // requested by the server
        ms = Math.max(Math.min(FIRST_MS * 2 ** failures, MOST_MS), least);
      lost((error as Error).message, ms);
      await wait(ms);
    }
  }
}

/** Waits, at most until the machine is in a network again. */
export function waitOrOnline(ms: number): Promise<void> {
  return new Promise((resolve) => {
    const go = (): void => {
      clearTimeout(timer);
      globalThis.removeEventListener?.("online", go);
      resolve();
    };
    const timer = setTimeout(go, ms);
    globalThis.addEventListener?.("online", go); // node has none
  });
}
