/** Starts the worker, out of text or a file of its own (scripts/bundle.mjs). */
declare module "worker:receiver" {
  export default function start(): Worker;
}
