// Properties of the element: frameworks set them to booleans, to the empty string, and to undefined to remove them.

import assert from "node:assert/strict";
import { test } from "node:test";

/** An element without a document, with its attributes and events. */
class FakeElement {
  readonly attributes = new Map<string, string>();
  readonly events: CustomEvent[] = [];
  shadowRoot: { textContent: string } | null = null;
  readonly isConnected = true;

  attachShadow(): { textContent: string } {
    return (this.shadowRoot = { textContent: "" });
  }

  dispatchEvent(event: CustomEvent): void {
    this.events.push(event);
  }

  getAttribute(name: string): string | null {
    return this.attributes.get(name) ?? null;
  }

  hasAttribute(name: string): boolean {
    return this.attributes.has(name);
  }

  setAttribute(name: string, value: unknown): void {
    this.attributes.set(name, String(value));
  }

  removeAttribute(name: string): void {
    this.attributes.delete(name);
  }

  toggleAttribute(name: string, force = !this.attributes.has(name)): void {
    if (force) this.attributes.set(name, "");
    else this.attributes.delete(name);
  }
}

/** Attribute of each property. */
const ATTRIBUTES = {
  src: "src",
  session: "session",
  fingerprint: "fingerprint",
  concealer: "concealer",
  viewpoint: "viewpoint",
  up: "up",
  panel: "panel",
  gestures: "gestures",
  autorotate: "autorotate",
  poster: "poster",
  cameraLimits: "camera-limits",
  maxGaussians: "max-gaussians",
  updates: "updates",
};

test("properties set attributes as templates of frameworks mean them", async () => {
  Object.assign(globalThis, { HTMLElement: FakeElement });
  const { SplatWire } = await import("../src/page/element.ts"),
    element = new SplatWire(),
    properties = element as unknown as Record<string, unknown>;
  for (const [property, attribute] of Object.entries(ATTRIBUTES))
    for (const [given, expected] of [
      ["", ""],
      [undefined, null],
      ["a", "a"],
      [null, null],
      [true, ""],
      [false, null],
      [undefined, null],
      [8, "8"],
      [0, property === "updates" ? null : "0"],
      [NaN, property === "updates" ? null : "NaN"],
      ["false", "false"],
    ]) {
      properties[property] = given;
      assert.equal(element.getAttribute(attribute), expected, `${property} = ${given}`);
      assert.equal(element.updates, property === "updates" && expected !== null && expected !== "false");
    }
});

test("properties that a page set before the element was defined become attributes once it is connected", async () => {
  Object.assign(globalThis, { HTMLElement: FakeElement });
  const { SplatWire } = await import("../src/page/element.ts"),
    element = new SplatWire(),
    start = (): ShadowRoot => {
      throw new Error("started");
    };
  for (const [name, value] of Object.entries({ src: "a.swz", cameraLimits: "1 2 3 4", updates: true, other: 1 }))
    Object.defineProperty(element, name, { value, configurable: true, enumerable: true, writable: true });
  assert.throws(() => Object.assign(element, { attachShadow: start }).connectedCallback(), /started/);
  const { attributes } = element as unknown as FakeElement;
  assert.deepEqual(Object.fromEntries(attributes), { src: "a.swz", "camera-limits": "1 2 3 4", updates: "" });
  element.src = "b.swz";
  assert.equal(attributes.get("src"), "b.swz");
});

test("frameworks can set every attribute: React assigns to a property of its name if there is one", async () => {
  Object.assign(globalThis, { HTMLElement: FakeElement });
  const { SplatWire } = await import("../src/page/element.ts");
  for (const name of SplatWire.observedAttributes) {
    const element = new SplatWire();
    if (name in element) Object.assign(element, { [name]: "8" });
    else element.setAttribute(name, "8");
    assert.equal(element.hasAttribute(name), true, name);
  }
});

test("where the browser lacks an interface, as jsdom does, the element reports it and throws nothing", async () => {
  Object.assign(globalThis, { HTMLElement: FakeElement });
  const { SplatWire } = await import("../src/page/element.ts"),
    element = new SplatWire();
  element.connectedCallback();
  const { events, shadowRoot } = element as unknown as FakeElement;
  assert.equal(events.length, 0, "listeners are added later in the same task");
  await new Promise((resolve) => setTimeout(resolve));
  assert.deepEqual(
    events.map(({ type, detail }) => [type, detail]),
    [["error", { message: "this browser has no Worker" }]],
  );
  assert.equal(element.status.failed, "this browser has no Worker");
  assert.equal(shadowRoot?.textContent, "this browser has no Worker");
});
