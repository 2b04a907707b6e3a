// Promises that reject if their source has ended.

/** Settles as `work` does, or rejects with the reason of a signal that is aborted first. */
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
