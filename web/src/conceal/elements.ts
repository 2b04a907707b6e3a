// What concealers ask about elements.

/**
 * What is known of all elements of a scene, received or lost: lost ones lie and are as large as is expected of them.
 */
export interface Elements {
  /** x, y, z of each. */
  readonly positions: Float32Array;
  /** Each one's size: what it counts for among its neighbours, unless that of its tier is known. */
  readonly sizes: Float32Array;
  /** How large elements of each one's tier are; null where the sender does not say. */
  readonly tierSizes: Float32Array | null;
  /** Of those that arrived; null where an element has no opacity of its own. */
  readonly opacities: Float32Array | null;
  readonly known: Uint8Array;
  /** Which elements of the scene they are: of those that are equally far from one, the first counts. */
  readonly places: Int32Array;
  /** Logarithms of the axes of received Gaussians, largest first; null for anchors. */
  readonly logScales: Float32Array | null;
  /** What there is to know of received anchors, the first elements; null for explicit Gaussians. */
  readonly anchors: (() => AnchorFacts) | null;
}

export interface AnchorFacts {
  /** Logarithms of the unit of each one's offsets and of its three sizes. */
  readonly logs: Float64Array;
  /** How many Gaussians each has. */
  readonly active: Uint8Array;
  /**
   * Logarithms of how far features are expected to be off, in their spreads, and lengths, in what is expected of them.
   */
  readonly unsure: Float64Array;
}
