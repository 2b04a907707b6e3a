// Inputs of the concealers.

/** Properties of all elements of a scene. Those of lost elements are predicted. */
export interface Elements {
  /** Positions x, y, z, shape (count, 3). */
  readonly positions: Float32Array;
  /** Sizes, shape (count). They weight the elements unless `tierSizes` is present. */
  readonly sizes: Float32Array;
  /** Typical size of each element's tier, shape (count); null if the stream does not contain it. */
  readonly tierSizes: Float32Array | null;
  /** Opacities of received elements; null for elements without individual opacity. */
  readonly opacities: Float32Array | null;
  /** 1 for drawn elements: received ones, redundant copies, tracks with concealed motion; 0 for lost ones. */
  readonly isReceived: Uint8Array;
  /** Index of each element in the scene. It decides ties between equally distant elements. */
  readonly indices: Int32Array;
  /** Log lengths of the received Gaussians' axes, shape (received, 3), largest first; null for anchors. */
  readonly logScales: Float32Array | null;
  /** Further properties of the received anchors, which are the first elements; null for explicit Gaussians. */
  readonly anchors: (() => AnchorProperties) | null;
}

export interface AnchorProperties {
  /** Logarithms of the unit of the offsets and of the three sizes, shape (received, 4). */
  readonly logs: Float64Array;
  /** Number of Gaussians of each anchor. */
  readonly numGaussians: Uint8Array;
  /**
   * Log of the features' expected error in units of their spread, and of the lengths' error in units of its prediction;
   * shape (received, 2).
   */
  readonly expectedErrors: Float64Array;
}
