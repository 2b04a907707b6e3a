// Content Security Policy (CSP) of the page: requests that it forbids give an error with the directive and the address.

import { delay } from "../scheduler.ts";
import { withoutQuery } from "./http_error.ts";

/** Time that a browser may take to report a violation after a request has failed, milliseconds. */
const REPORT_MS = 50;

const { addEventListener: listen } = globalThis as Partial<typeof globalThis>; // not available in node
let last: SecurityPolicyViolationEvent | null = null;
listen?.("securitypolicyviolation", (event) => {
  const violation = event as SecurityPolicyViolationEvent;
  if (violation.disposition === "enforce") last = violation; // others are only reported
});

/**
 * Awaits a request of `url`. If it failed because the page's policy forbids it, throws a final error (`isFinal`) that
 * names the directive and the address.
 */
export async function permitted<T>(url: string, request: Promise<T>): Promise<T> {
  try {
    return await request;
  } catch (error) {
    if (listen) await delay(REPORT_MS);
    // `blockedURI` has no fragment, unlike `url`
    if (!last || !url.startsWith(last.blockedURI)) throw error;
    const { blockedURI, effectiveDirective } = last,
      directive = effectiveDirective.replace("-elem", ""),
      text = `the page's policy (CSP) forbids ${withoutQuery(blockedURI)}: allow it in ${directive}`;
    throw Object.assign(new Error(text), { final: true });
  }
}
