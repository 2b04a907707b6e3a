// Decoded packet of explicit Gaussians.

import type { Packet } from "../../packets/packet.ts";
import type { ElementBatch, ViewGaussians } from "../element_batch.ts";
import type { Splats } from "../splats.ts";

export class GaussianBatch implements ElementBatch {
  constructor(
    readonly packet: Packet | null,
    readonly splats: Splats,
    readonly planIndices: () => Int32Array,
  ) {}

  get indices(): Int32Array {
    return this.planIndices();
  }

  get count(): number {
    return this.splats.count;
  }

  forCamera(): ViewGaussians {
    return { splats: this.splats, owners: null };
  }
}
