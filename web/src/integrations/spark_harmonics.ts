// Harmonics in Spark's textures.

/** Texture and component of coefficients 1 to 15 in Spark's shader. Spark's own encoder misplaces degree 2. */
const PLACES = [
  ...[0, 1, 2, 3].map((word) => ["sh1", word] as const),
  ...[0, 1, 2, 3].map((word) => ["sh2", word] as const),
  ...[0, 1, 2, 3].map((word) => ["sh3a", word] as const),
  ...[0, 1, 2].map((word) => ["sh3b", word] as const),
];

/** Returns the texture and component of each coefficient of a degree, from the first one. */
export const coefficientSlots = (degree: number): readonly (readonly [keyof typeof TEXTURE_NAMES, number])[] =>
  PLACES.slice(0, (degree + 1) ** 2 - 1);

/** Name under which Spark keeps the texture of each array in `extra`. */
export const TEXTURE_NAMES = {
  sh1: "sh1Texture",
  sh2: "sh2Texture",
  sh3a: "sh3TextureA",
  sh3b: "sh3TextureB",
} as const;
