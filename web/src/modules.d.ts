/** Module that starts the worker from embedded text or from a separate file (scripts/bundle.mjs). */
declare module "worker:receiver" {
  export default function start(): Worker;
}
