// Allocation of WebGL contexts. Browsers allow about 16 per page, 8 on phones, and drop the oldest beyond that. Visible
// elements get one of ours; the rest is left to the page.

const MAX_CONTEXTS = 8;

/** Owner of a WebGL context. */
export interface ContextOwner {
  readonly isVisible: boolean;
  /** Releases the context. */
  release(): void;
  /** Announces that a context is available. */
  onContextAvailable(): void;
}

/** Owners of a context, oldest first. */
const owners: ContextOwner[] = [],
  waiting = new Set<ContextOwner>();

/**
 * Acquires a context, if necessary from an invisible owner. Returns false if none is available; then
 * `onContextAvailable` is called later.
 */
export function acquireContext(holder: ContextOwner): boolean {
  if (owners.length >= MAX_CONTEXTS) {
    const other = owners.find(({ isVisible }) => !isVisible);
    if (!other) {
      waiting.add(holder);
      return false;
    }
    owners.splice(owners.indexOf(other), 1);
    other.release();
  }
  waiting.delete(holder);
  owners.push(holder);
  return true;
}

/** Returns a context, or cancels the wait for one. */
export function releaseContext(holder: ContextOwner): void {
  const place = owners.indexOf(holder);
  waiting.delete(holder);
  if (place >= 0) owners.splice(place, 1);
  if (owners.length < MAX_CONTEXTS) offerContext(); // also one that was offered to `holder`
}

/** Offers a context to the next visible owner that waits, because another owner became invisible. */
export function offerContext(): void {
  const next = [...waiting].find(({ isVisible }) => isVisible);
  if (!next) return;
  waiting.delete(next);
  next.onContextAvailable();
}
