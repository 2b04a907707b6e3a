// Taking turns in a thread: timers that wait for nothing wait for 4 ms all the same once they are nested, messages do
// not.

const channel = new MessageChannel(),
  waiting: (() => void)[] = [];
channel.port1.onmessage = () => waiting.shift()?.();

/** Resolves after everything else that this thread has to do by now. */
export function nextTurn(): Promise<void> {
  return new Promise((resolve) => {
    waiting.push(resolve);
    channel.port2.postMessage(null);
  });
}
