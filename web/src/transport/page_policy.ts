// Content Security Policy (CSP) of the page: requests that it forbids give an error with the directive and the address.

import { delay } from "../scheduler.ts";
import { withoutQuery } from "./http_error.ts";

/** Time that a browser may take to report a violation after a request has failed, milliseconds. */
const REPORT_MS = 50;

/**
 * Awaits a request of `url` that this task has started. If it failed because the page's policy forbids it, throws a
 * final error (`isFinal`) that names the directive and the address.
 */
export async function permitted<T>(url: string, request: Promise<T>): Promise<T> {
  const page: Partial<typeof globalThis> = globalThis, // node has no events
    { href, origin, protocol } = new URL(url),
    // browsers report the origin alone for other origins after redirects, and the scheme alone for blob: and data:
    addresses = protocol.startsWith("http") ? [href.split("#")[0], origin] : [protocol.slice(0, -1)];
  let violation: SecurityPolicyViolationEvent | null = null;
  const note = (event: SecurityPolicyViolationEvent): void => {
    if (event.disposition === "enforce" && addresses.includes(event.blockedURI)) violation = event;
  };
  page.addEventListener?.("securitypolicyviolation", note);
  try {
    return await request;
  } catch (error) {
    if (page.addEventListener) await delay(REPORT_MS);
    if (!violation) throw error;
    const { blockedURI, effectiveDirective } = violation as SecurityPolicyViolationEvent,
      directive = effectiveDirective.replace("-elem", ""),
      text = `the page's policy (CSP) forbids ${withoutQuery(blockedURI)}: allow it in ${directive}`;
    throw Object.assign(new Error(text), { final: true });
  } finally {
    page.removeEventListener?.("securitypolicyviolation", note);
  }
}
