// WebGL contexts are few: browsers have 16 for a page, on phones 8, and take the oldest away for one more, whosever it
// is. Those in sight have them here, and some are left to the rest of the page.

const MOST = 8;

/** Something that draws where it has a context. */
export interface Holder {
  readonly inSight: boolean;
  /** Gives its context back. */
  release(): void;
  /** Hears that there is one again. */
  offered(): void;
}

/** Holders of a context, in the order in which they got it. */
const holders: Holder[] = [],
  waiting = new Set<Holder>();

/** Whether a holder may make a context; if not, it hears when it may. One that nobody sees makes way. */
export function acquire(holder: Holder): boolean {
  if (holders.length >= MOST) {
    const other = holders.find(({ inSight }) => !inSight);
    if (!other) {
      waiting.add(holder);
      return false;
    }
    holders.splice(holders.indexOf(other), 1);
    other.release();
  }
  waiting.delete(holder);
  holders.push(holder);
  return true;
}

/** A holder has none any more, or wants none. */
export function giveBack(holder: Holder): void {
  const place = holders.indexOf(holder);
  waiting.delete(holder);
  if (place < 0) return;
  holders.splice(place, 1);
  offer();
}

/** Somebody went out of sight who could make way. */
export function offer(): void {
  const [next] = waiting;
  if (!next) return;
  waiting.delete(next);
  next.offered();
}
