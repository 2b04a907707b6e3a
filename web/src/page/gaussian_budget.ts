// Maximum number of drawn Gaussians of a scene with levels.

const DEFAULT = 1_000_000,
  /** Default of devices that report at most this memory, GiB. */
  SMALL_MEMORY = 4,
  SMALL_DEFAULT = 500_000,
  /** Minimum after losses of the WebGL context. */
  MIN_GAUSSIANS = 50_000;

/** Returns the maximum of an attribute, or that of the device, halved for each loss of the WebGL context. */
export function gaussianBudget(attribute: string | null, losses: number): number {
  const given = Math.floor(Number(attribute)),
    { deviceMemory = Infinity } = (globalThis.navigator ?? {}) as { deviceMemory?: number },
    most = given > 0 ? given : deviceMemory <= SMALL_MEMORY ? SMALL_DEFAULT : DEFAULT;
  return Math.min(most, Math.max(most / 2 ** losses, MIN_GAUSSIANS));
}
