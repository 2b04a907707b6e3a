// Promises that reject if their source has ended.

/**
 * Starts `work` and settles as it does, or rejects with the reason of a signal that is aborted before. Work is not
 * started after an abort.
 */
export async function unlessAborted<T>(work: () => Promise<T>, ...signals: readonly AbortSignal[]): Promise<T> {
  const settled = new AbortController();
  for (const each of signals) each.throwIfAborted();
  return new Promise<T>((resolve, reject) => {
    for (const each of signals) each.addEventListener("abort", () => reject(each.reason), { signal: settled.signal });
    work().then(resolve, reject);
  }).finally(() => settled.abort());
}
