// What a server says that does not give what it was asked for.

/** A server's answer that is no file; asking again helps where `final` is not set. */
export class Refused extends Error {
  readonly final: boolean;

  constructor(url: string, { status, statusText }: Response) {
    super(`${url} answers ${status} ${statusText}`.trim());
    this.final = status >= 400 && status < 500 && status !== 408 && status !== 429;
  }
}
