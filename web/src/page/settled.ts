// Promises that reject if their source has ended.

/** Settles as `work` does. If a signal is aborted first, it rejects with the reason of the signal. */
export function unlessAborted<T>(work: Promise<T>, ...signals: readonly AbortSignal[]): Promise<T> {
  const settled = new AbortController();
  return new Promise<T>((resolve, reject) => {
    for (const each of signals) {
      const end = (): void => reject(each.reason);
      if (each.aborted) end();
      each.addEventListener("abort", end, { signal: settled.signal });
    }
    work.then(resolve, reject);
  }).finally(() => settled.abort());
}
