/** The worker's own bundle as text: one file is all that a page loads. */
declare module "worker:receiver" {
  const source: string;
  export default source;
}
