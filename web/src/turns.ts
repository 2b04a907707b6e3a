// Taking turns in a thread: timers that wait for nothing wait for 4 ms all the same once they are nested, messages do
// not.

/**
 * Called now and then by what takes long, so that its thread can do other things; false where nobody waits any more.
 */
export type Pause = () => Promise<boolean>;

/** How long work may hold up the rest of its thread. */
export const SLICE_MS = 8;

export const pause = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

let channel: MessageChannel | null = null;
const waiting: (() => void)[] = [];

/** Resolves after everything else that this thread has to do by now. */
export function nextTurn(): Promise<void> {
  // in node an open channel would keep the program from its end
  const { setImmediate } = globalThis as { setImmediate?: (go: () => void) => void };
  if (setImmediate) return new Promise((resolve) => setImmediate(resolve));
  if (!channel) {
    channel = new MessageChannel();
    channel.port1.onmessage = () => waiting.shift()?.();
  }
  const { port2 } = channel;
  return new Promise((resolve) => {
    waiting.push(resolve);
    port2.postMessage(null);
  });
}

/** Lets other work of this thread through now and then. */
export function pausing(wanted: () => boolean = () => true): Pause {
  let since = performance.now();
  return async () => {
    if (performance.now() - since > SLICE_MS) {
      await nextTurn();
      since = performance.now();
    }
    return wanted();
  };
}
