// Cooperative scheduling within a thread. It uses messages because browsers delay nested timers by at least 4 ms.

/** Yields to other work of the thread from time to time. Resolves to false once the result is no longer needed. */
export type Pause = () => Promise<boolean>;

/** Longest time that a task may block its thread, milliseconds. */
export const SLICE_MS = 8;

export const delay = (ms: number): Promise<void> => new Promise((resolve) => setTimeout(resolve, ms));

let channel: MessageChannel | null = null;
const waiting: (() => void)[] = [];

/** Resolves after the tasks that are already queued in this thread. */
export function nextTask(): Promise<void> {
  // in node an open channel would keep the process alive
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

/** Returns a function that yields to other work of this thread every `SLICE_MS`. */
export function periodicPause(wanted: () => boolean = () => true): Pause {
  let since = performance.now();
  return async () => {
    if (performance.now() - since > SLICE_MS) {
      await nextTask();
      since = performance.now();
    }
    return wanted();
  };
}
