// Packet decoder of explicit Gaussians and of motion, compiled to WebAssembly by `npm run native`. It is the
// counterpart of `src/codec/gaussians/packet.ts` and of `src/codec/tracks/`, which decode bit for bit the same where a
// page forbids WebAssembly.
//
// One instance decodes the packets of one stream. Another one counts the elements of lanes and hashes, which needs no
// tables. The caller fills the tables below, then for each packet copies the
// payload to the address that `begin` returns. It calls `decode`, which returns the address of the integers.

#include <stdint.h>
#include <wasm_simd128.h>

#define INLINE static inline __attribute__((always_inline))
#define EXPORT(name) __attribute__((export_name(#name)))
#define ROTATED(word, bits) __builtin_rotateright32(word, bits)
#define TURNED(words, bits) (wasm_u32x4_shr(words, bits) | wasm_i32x4_shl(words, 32 - bits))
#define NUM_SCALES 320
#define MEANS 8
#define CONTEXTS (8 * DEVIATION_CONTEXTS * SECOND_CONTEXTS)
#define DEVIATION_CONTEXTS 12
#define SECOND_CONTEXTS 16
#define COLUMNS 17
#define WINDOW 64
#define NEIGHBOURS 6
#define LANES 8
#define PREDICTED 8
#define PAIRS (PREDICTED / 2)
#define NONE 0x7fffffff
#define FAR ((1 << 25) - 1)       // above all squared distances of narrow cells
#define NOWHERE (-30000 & 0xffff)  // x of the places before the first Gaussian; the square of its distance fits
#define NARROW_BITS 11
#define TOTAL (1 << 24)
#define ESCAPE 16
#define MOST_GUESS_BITS 8
#define MOST_BOUNDS 512  // of a distribution that are stored
#define ZEROS 16         // bytes behind a payload that may be read
#define FIRST_CLASS 32
#define FIRST_HARMONIC (FIRST_CLASS + 18 * 8)
#define FIRST_MAGNITUDE (FIRST_HARMONIC + 8 + 64)
#define NUM_CONTEXTS (FIRST_MAGNITUDE + 24)
#define MOTION_CONTEXTS 1208
#define BITS 12
#define DIRECTION_BITS 14
#define ONE (1 << DIRECTION_BITS)
#define MAX_LOG (40 << BITS)
#define MAX_COMPANDED 5903
#define MAX_COLOUR (1 << (BITS + 8))
#define MAX_RESIDUAL (1 << 24)
#define MAX_HARMONIC (1 << 24)
#define Z_LIMIT (6 * 65536)
#define OCTAVES 128
#define MOST_HARMONICS 16  // of a colour channel, rounded up to an even number
#define TRANSFORM_UNIT 127
#define PI 3.141592653589793
#define LN2 0.6931471805599453
#define R2 1.4142135623730951
#define R3 1.7320508075688772
#define R6 2.449489742783178

enum { LATTICE = 0, CLASS = 3, OPACITY = 4, SCALE0 = 5, AXIS = 8, PRIMARY = 11, SPIN_BITS = 12, SPIN = 13, LUMA = 14 };
enum { S_POSITION = 4, S_DIRECTION = 5, S_SPIN = 6, S_COLOUR = 7, S_HARMONICS = 8, STEPS = 9 };

// Tables that the caller fills: of the range coder, of the codec, of the stream, and the block's means.
int32_t normal[2 * 768 + 1], inverses[NUM_SCALES], widths[NUM_SCALES];
int32_t coefficients[4 * STEPS];
int32_t constants[8 * STEPS], scales[CONTEXTS], initial[2 * NUM_CONTEXTS];
int32_t defaults[7];
// Tables of the conversion to floating point: powers of two of the fractions of an octave and of whole octaves, the
// transform of the harmonics, with rows of `MOST_HARMONICS` numbers, and the lower corner of the block.
double fractions[1 << BITS], wholes[2 * OCTAVES], transform[MOST_HARMONICS * MOST_HARMONICS], corner[3];

static int32_t thinness[MAX_COMPANDED + 1];       // see `src/codec/gaussians/tables.ts`
static int32_t models[2 * MOTION_CONTEXTS];  // of Gaussians or of motion
static const int32_t running_bounds[7] = {2, 6, 13, 24, 42, 74, 135};

// Memory: distributions grow from the end of the program's data, arrays of a packet lie behind a fixed distance.

extern uint8_t __heap_base;
static uint32_t heap_end;

static void reserve(uint32_t end) {
  uint32_t pages = (end + 65535) >> 16, now = __builtin_wasm_memory_size(0);
  if (pages > now && __builtin_wasm_memory_grow(0, pages - now) == (uint32_t)-1) __builtin_trap();
}

static inline int32_t clip(int32_t value, int32_t low, int32_t high) {
  return value < low ? low : value > high ? high : value;
}
static inline int32_t bits_of(uint32_t value) { return value ? 32 - __builtin_clz(value) : 0; }
static inline int32_t smaller(int32_t a, int32_t b) { return a < b ? a : b; }
static inline int32_t larger(int32_t a, int32_t b) { return a > b ? a : b; }
static inline double magnitude(double value) { return __builtin_fabs(value); }

// Range decoder; see `src/entropy/decoder.ts`. The payload is reversed, so that one load gives the next eight bytes with
// the first of them as the highest. The zeros before it are read after its last byte.

static uint64_t code, span;
static const uint8_t *next, *last;

INLINE void take(uint64_t start, uint64_t size) {
  uint64_t rest = code - start, word;
  if (rest > size - 1) rest = size - 1;
  // As few whole bytes as give a range of at least 2^40; `size` is below 2^48. There are no branches, because half of
  // them would be mispredicted.
  uint32_t bits = (uint32_t)(__builtin_clzll(size) - 16) & 56;
  __builtin_memcpy(&word, next, 8);
  code = rest << bits | (word >> 8) >> (56 - bits);
  span = size << bits;
  next -= bits >> 3;
  if (next < last) next = last;
}

// Starts to decode a payload of `bytes` bytes at `heap_end`, which is copied to `reversed`.
static void start_decoder(uint32_t bytes, uint8_t *reversed) {
  const uint8_t *payload = (const uint8_t *)heap_end;
  for (uint32_t i = 0; i < ZEROS; i++) reversed[i] = 0;
  for (uint32_t i = 0; i < bytes; i++) reversed[ZEROS + i] = payload[bytes - 1 - i];
  last = reversed;
  next = reversed + ZEROS + bytes - 8;
  __builtin_memcpy(&code, next, 8);
  code >>= 16;
  next -= 6;
  span = 1ULL << 48;
}

INLINE uint32_t target(uint64_t unit, uint32_t most) {
  uint64_t found = code / unit;
  return found < most ? (uint32_t)found : most;
}

static int bit(int32_t context) {
  int32_t *model = models + 2 * context, slow = model[0], fast = model[1];
  uint64_t zero = (uint64_t)clip((slow + fast) >> 1, 32, 65536 - 32), unit = span >> 16;
  if (code >= zero * unit) {
    take(zero * unit, (65536 - zero) * unit);
    model[0] = slow - (slow >> 7);
    model[1] = fast - (fast >> 4);
    return 1;
  }
  take(0, zero * unit);
  model[0] = slow + ((65536 - slow) >> 7);
  model[1] = fast + ((65536 - fast) >> 4);
  return 0;
}

// At most 16 bits.
INLINE uint32_t few(int32_t bits) {
  uint64_t unit = span >> bits, part = target(unit, (1u << bits) - 1);
  take(unit * part, unit);
  return (uint32_t)part;
}

static uint64_t raw(int32_t bits) {
  uint64_t value = 0;
  while (bits > 0) {
    int32_t some = smaller(bits, 16);
    value = value << some | few(some);
    bits -= some;
  }
  return value;
}

static uint32_t below(uint32_t count) {
  uint64_t unit = span >> 16;
  if (count == 1) {  // the whole range, which is too large for `take`
    span = unit << 16;
    if (code > span - 1) code = span - 1;
    return 0;
  }
  uint32_t value = (uint32_t)(((uint64_t)(target(unit, 65535) + 1) * count - 1) >> 16);
  uint32_t start = (value << 16) / count, after = ((value + 1) << 16) / count;  // `count` is below 2^16
  take(unit * start, unit * (after - start));
  return value;
}

static uint64_t gamma_code(void) {
  int32_t length = 0;
  uint64_t value = 1;
  while (length < 32 && raw(1)) length++;
  for (; length > 0; length--) value = 2 * value + raw(1);
  return value - 1;
}

// Integers under mixtures of two normals; see `src/entropy/mixture.ts`.

static int64_t cdf(int64_t distance, int32_t inverse) {
  int64_t z = (distance * inverse) >> 16;
  if (z <= -Z_LIMIT) return 0;
  if (z >= Z_LIMIT) return TOTAL;
  int32_t cell = (int32_t)((z + Z_LIMIT) >> 9);
  int64_t base = normal[cell];
  return base + (((normal[cell + 1] - base) * ((z + Z_LIMIT) & 511)) >> 9);
}

static int32_t half_width(int32_t scale) { return widths[smaller(scale + 24, NUM_SCALES - 1)]; }

static int32_t bound_of(int32_t place, int32_t scale, int32_t mean, int32_t half) {
  int32_t count = 2 * half + 1;
  if (place <= 0) return 0;
  if (place >= count) return TOTAL - ESCAPE;
  int64_t distance = (int64_t)(place - half) * 4096 - 2048 - mean * 512;
  int64_t sum = cdf(distance, inverses[scale]) * 45875 +
                cdf(distance, inverses[smaller(scale + 24, NUM_SCALES - 1)]) * (65536 - 45875);
  return (int32_t)((((sum >> 16) * (TOTAL - ESCAPE - count)) >> 24) + place);
}

// Distributions of one scale for all means, one after another: bounds of every `1 << shift`-th symbol's interval, and
// for each position's `guess_bits` high bits the first bound to try. Narrow ones have a `shift` of 0. They are accessed
// at random, so they are kept small enough for the processor's caches.
typedef struct {
  const uint16_t *guesses;
  const int32_t *bounds;
  int32_t stride, half, scale, shift, guess_bits;
} Mixtures;
static Mixtures mixtures[NUM_SCALES];

static void tabulate(const Mixtures *own, int32_t mean, uint16_t *guesses, int32_t *bounds) {
  int32_t most = own->stride - 1;
  for (int32_t place = 0; place <= most; place++)
    bounds[place] = bound_of(place << own->shift, own->scale, mean, own->half);
  for (int32_t guess = 0, place = 0; guess < 1 << own->guess_bits; guess++) {
    while (place < most - 1 && bounds[place + 1] <= guess << (24 - own->guess_bits)) place++;
    guesses[guess] = (uint16_t)place;
  }
}

static int32_t outside(int32_t half) {
  uint64_t unit = span >> 24;
  take(unit * (TOTAL - ESCAPE), unit * ESCAPE);
  int above = (int)raw(1);
  uint64_t value = half + 1 + gamma_code();
  int32_t found = value > MAX_RESIDUAL ? MAX_RESIDUAL : (int32_t)value;
  return above ? found : -found;
}

// Finds the symbol between two stored bounds, `start` and `after`. The first guess interpolates them.
static int32_t between(
    const Mixtures *own, int32_t place, int32_t start, int32_t after, int32_t mean, int32_t position) {
  int32_t scale = own->scale, half = own->half, first = place << own->shift;
  place = first + (int32_t)(((int64_t)(position - start) << own->shift) / (after - start));
  start = bound_of(place, scale, mean, half);
  while (start > position) start = bound_of(--place, scale, mean, half);
  for (;; place++, start = after) {
    after = bound_of(place + 1, scale, mean, half);
    if (after > position) break;
  }
  uint64_t unit = span >> 24;
  take(unit * start, unit * (after - start));
  return place - half;
}

INLINE int32_t symbol(const Mixtures *own, int32_t mean) {
  uint64_t unit = span >> 24;
  int32_t position = (int32_t)target(unit, TOTAL - 1);
  if (position >= TOTAL - ESCAPE) return outside(own->half);
  const int32_t *bounds = own->bounds + (mean + 4) * own->stride;
  int32_t bits = own->guess_bits, place = own->guesses[(mean + 4) << bits | position >> (24 - bits)];
  int32_t start = bounds[place], after = bounds[place + 1];
  while (after <= position) {
    place++;
    start = after;
    after = bounds[place + 1];
  }
  if (own->shift) return between(own, place, start, after, mean, position);
  take(unit * start, unit * (after - start));
  return place - own->half;
}

// Cells; see `src/codec/gaussians/cells.ts`.

static uint64_t *codes;
static int32_t *cells;
static uint32_t count;

static void read_codes(int32_t bits) {
  struct { uint32_t begin, end; int32_t bit, run; uint64_t prefix; } stack[68], node;
  int32_t top = 0;
  stack[0].begin = 0, stack[0].end = count, stack[0].bit = bits - 1, stack[0].run = 0, stack[0].prefix = 0;
  while (top >= 0) {
    node = stack[top--];
    uint32_t n = node.end - node.begin;
    if (n == 0) continue;
    if (node.bit < 0 || n == 1) {
      uint64_t value = node.prefix;
      if (node.bit >= 0) value = value << (node.bit + 1) | raw(node.bit + 1);
      for (uint32_t i = node.begin; i < node.end; i++) codes[i] = value;
      continue;
    }
    int32_t size = smaller(bits_of(n) - 1, 8), together = bit((size - 1) * 4 + node.run);
    uint32_t zeros = together ? (raw(1) ? n : 0) : 1 + below(n - 1);
    int32_t run = together ? smaller(node.run + 1, 3) : 0;
    top++;
    stack[top].begin = node.begin + zeros, stack[top].end = node.end, stack[top].bit = node.bit - 1;
    stack[top].run = run, stack[top].prefix = node.prefix << 1 | 1;
    top++;
    stack[top].begin = node.begin, stack[top].end = node.begin + zeros, stack[top].bit = node.bit - 1;
    stack[top].run = run, stack[top].prefix = node.prefix << 1;
  }
}

static int32_t coordinate(uint64_t value) {
  value &= 0x1249249249249249;
  value = (value | value >> 2) & 0x10C30C30C30C30C3;
  value = (value | value >> 4) & 0x100F00F00F00F00F;
  value = (value | value >> 8) & 0x1F0000FF0000FF;
  value = (value | value >> 16) & 0x1F00000000FFFF;
  return (int32_t)((value | value >> 32) & 0x1FFFFF);
}

static void read_cells(int32_t depth) {
  int32_t spread = (int32_t)raw(1), size = spread ? smaller(3 * depth, 8) : 0;
  uint32_t first = (uint32_t)raw(size), slots = (uint32_t)raw(size) + 1;
  read_codes(3 * depth - size);
  for (uint32_t i = 0; i < count; i++) {
    uint64_t value = codes[i];
    if (spread) {
      uint32_t slot = first + below(slots);
      for (int32_t b = size - 1; b >= 0; b--) value = value << 1 | ((slot >> (size - 1 - b)) & 1);
    }
    for (int32_t a = 0; a < 3; a++) cells[a * count + i] = coordinate(value >> a);
  }
}

// Neighbours; see `src/codec/gaussians/neighbours.ts`.

static int32_t indices[NEIGHBOURS], num_near;
static double weights[NEIGHBOURS];
static int32_t means[PREDICTED], deviations[PREDICTED];
static double *values;
static int32_t *axes;

// Cells as pairs of 16 bits, x and y in one array, z and 0 in the other, behind `WINDOW` places that are far away.
static int32_t *narrow_xy, *narrow_z;

static void find_narrow(uint32_t i) {
  int32_t keys[WINDOW];
  const int32_t *xys = narrow_xy + i, *zs = narrow_z + i;
  v128_t xy = wasm_i32x4_splat(xys[WINDOW]), z = wasm_i32x4_splat(zs[WINDOW]);
  v128_t age = wasm_i32x4_const(WINDOW - 1, WINDOW - 2, WINDOW - 3, WINDOW - 4), four = wasm_i32x4_const_splat(4);
  v128_t far = wasm_i32x4_const_splat(FAR), most[2] = {wasm_i32x4_const_splat(NONE), wasm_i32x4_const_splat(NONE)};
  for (int32_t k = 0; k < WINDOW; k += 4) {
    v128_t a = wasm_i16x8_sub(xy, wasm_v128_load(xys + k)), c = wasm_i16x8_sub(z, wasm_v128_load(zs + k));
    v128_t d = wasm_i32x4_add(wasm_i32x4_dot_i16x8(a, a), wasm_i32x4_dot_i16x8(c, c));
    v128_t key = wasm_v128_or(wasm_i32x4_shl(wasm_i32x4_min(d, far), 6), age);
    wasm_v128_store(keys + k, key);
    most[k >> 2 & 1] = wasm_i32x4_min(most[k >> 2 & 1], key);
    age = wasm_i32x4_sub(age, four);
  }
  // Two of the least keys of eight groups are at most the larger one of their pair, so that six of them are at most the
  // third smallest, the second largest, of four pairs.
  v128_t pairs = wasm_i32x4_max(most[0], most[1]), swapped = wasm_i32x4_shuffle(pairs, pairs, 1, 0, 3, 2);
  v128_t low = wasm_i32x4_min(pairs, swapped), high = wasm_i32x4_max(pairs, swapped);
  int32_t bound = larger(larger(wasm_i32x4_extract_lane(low, 0), wasm_i32x4_extract_lane(low, 2)),
                         smaller(wasm_i32x4_extract_lane(high, 0), wasm_i32x4_extract_lane(high, 2)));
  v128_t bounds = wasm_i32x4_splat(bound);
  int32_t k0 = NONE, k1 = NONE, k2 = NONE, k3 = NONE, k4 = NONE, k5 = NONE;
  uint64_t close = 0;
  for (int32_t k = 0; k < WINDOW; k += 16) {
    v128_t near[4];
    for (int32_t four = 0; four < 4; four++) near[four] = wasm_i32x4_le(wasm_v128_load(keys + k + 4 * four), bounds);
    v128_t half = wasm_i16x8_narrow_i32x4(near[0], near[1]), rest = wasm_i16x8_narrow_i32x4(near[2], near[3]);
    close |= (uint64_t)wasm_i8x16_bitmask(wasm_i8x16_narrow_i16x8(half, rest)) << k;
  }
  for (; close; close &= close - 1) {
    int32_t key = keys[__builtin_ctzll(close)], rest;
#define SORT(place) rest = larger(place, key), place = smaller(place, key), key = rest
    SORT(k0);
    SORT(k1);
    SORT(k2);
    SORT(k3);
    SORT(k4);
    k5 = smaller(k5, key);
  }
  indices[0] = k0, indices[1] = k1, indices[2] = k2, indices[3] = k3, indices[4] = k4, indices[5] = k5;
  int32_t found = smaller((int32_t)i, NEIGHBOURS);
  double nearest = ((k0 >> 6) + 1) * 4096.0;
  for (int32_t m = 0; m < found; m++) {
    int32_t key = indices[m];
    weights[m] = __builtin_floor(nearest / ((key >> 6) + 1));
    indices[m] = (int32_t)i - 1 - (key & 63);
  }
  num_near = found;
}

static void find_wide(uint32_t i) {
  const int32_t *xs = cells, *ys = xs + count, *zs = ys + count;
  int32_t found = 0, last = i < WINDOW ? 0 : (int32_t)i - WINDOW;
  for (int32_t j = (int32_t)i - 1; j >= last; j--) {
    double x = xs[i] - xs[j], y = ys[i] - ys[j], z = zs[i] - zs[j], d = x * x + y * y + z * z;
    if (d > 1099511627776.0) d = 1099511627776.0;
    if (found == NEIGHBOURS && d >= weights[NEIGHBOURS - 1]) continue;
    int32_t place = found < NEIGHBOURS ? found++ : NEIGHBOURS - 1;
    for (; place > 0 && weights[place - 1] > d; place--) {
      weights[place] = weights[place - 1];
      indices[place] = indices[place - 1];
    }
    weights[place] = d;
    indices[place] = j;
  }
  double nearest = (weights[0] + 1) * 4096;
  for (int32_t m = 0; m < found; m++) weights[m] = __builtin_floor(nearest / (weights[m] + 1));
  num_near = found;
}

// Returns the context of the class.
static int32_t predict(void) {
  if (!num_near) {
    for (int32_t c = 0; c < PREDICTED - 1; c++) means[c] = defaults[c], deviations[c] = 0;
    return 0;
  }
  double total = 0, classes;
  v128_t sums[PAIRS] = {0}, floors[PAIRS], apart[PAIRS] = {0};
  for (int32_t m = 0; m < num_near; m++) {
    const double *row = values + PREDICTED * indices[m];
    v128_t w = wasm_f64x2_splat(weights[m]);
    total += weights[m];
#pragma unroll
    for (int32_t c = 0; c < PAIRS; c++) sums[c] = wasm_f64x2_add(sums[c], wasm_f64x2_mul(w, wasm_v128_load(row + 2 * c)));
  }
  v128_t totals = wasm_f64x2_splat(total);
#pragma unroll
  for (int32_t c = 0; c < PAIRS; c++) floors[c] = wasm_f64x2_floor(wasm_f64x2_div(sums[c], totals));
  for (int32_t m = 0; m < num_near; m++) {
    const double *row = values + PREDICTED * indices[m];
    v128_t w = wasm_f64x2_splat(weights[m]);
#pragma unroll
    for (int32_t c = 0; c < PAIRS; c++) {
      v128_t distance = wasm_f64x2_abs(wasm_f64x2_sub(wasm_v128_load(row + 2 * c), floors[c]));
      apart[c] = wasm_f64x2_add(apart[c], wasm_f64x2_mul(w, distance));
    }
  }
#pragma unroll
  for (int32_t c = 0; c < PAIRS; c++) {
    wasm_v128_store64_lane(means + 2 * c, wasm_i32x4_trunc_sat_f64x2_zero(floors[c]), 0);
    wasm_v128_store64_lane(deviations + 2 * c, wasm_i32x4_trunc_sat_f64x2_zero(wasm_f64x2_div(apart[c], totals)), 0);
  }
  classes = wasm_f64x2_extract_lane(sums[PAIRS - 1], 1);
  return 1 + (int32_t)((4 * classes + total) / (2 * total));
}

static double axis[3];
static int32_t axis_deviation, axis_count;

static void predict_axis(int32_t primary) {
  double total = 0, x = 0, y = 0, z = 0;
  const int32_t *nearest = 0;
  int32_t same = 0;
  for (int32_t m = 0; m < num_near; m++) {
    const int32_t *u = axes + 4 * indices[m];
    if (u[3] != primary) continue;
    if (!same++) nearest = u;
    double w = u[0] * nearest[0] + u[1] * nearest[1] + u[2] * nearest[2] >= 0 ? weights[m] : -weights[m];
    x += w * u[0];
    y += w * u[1];
    z += w * u[2];
    total += weights[m];
  }
  axis_deviation = axis_count = 0;
  axis[0] = axis[1] = 0;
  axis[2] = ONE;
  if (!same || (x == 0 && y == 0 && z == 0)) return;
  double mx = __builtin_floor(x / total), my = __builtin_floor(y / total), mz = __builtin_floor(z / total), sum = 0;
  for (int32_t m = 0; m < num_near; m++) {
    const int32_t *u = axes + 4 * indices[m];
    if (u[3] != primary) continue;
    double near = magnitude(u[0] - mx) + magnitude(u[1] - my) + magnitude(u[2] - mz);
    double opposite = magnitude(u[0] + mx) + magnitude(u[1] + my) + magnitude(u[2] + mz);
    sum += weights[m] * (near < opposite ? near : opposite);
  }
  axis[0] = x, axis[1] = y, axis[2] = z;
  axis_deviation = (int32_t)(sum / total);
  axis_count = same;
}

// A Gaussian; see `src/codec/gaussians/packet.ts`.

static int32_t absolute, running;

static int32_t exponent(int32_t which, int32_t level, int32_t area, int32_t length, int32_t thin, int32_t opacity) {
  const int32_t *c = coefficients + 4 * which;
  return (c[0] * area + c[1] * length + c[2] * thin + c[3] * opacity + constants[8 * which + level]) >> 18;
}

static int32_t spread_context(int32_t near, int32_t deviation, int32_t shift) {
  if (near < 3) return near == 0 ? 0 : 1;
  return 2 + smaller(bits_of((uint32_t)((deviation * 8) >> shift)), DEVIATION_CONTEXTS - 3);
}

static int32_t value_of(int32_t stream, int32_t spread, int32_t mean, int32_t shift) {
  int32_t second = stream < 2 ? shift : smaller(bits_of((uint32_t)running), SECOND_CONTEXTS - 1);
  int32_t context = (stream * DEVIATION_CONTEXTS + spread) * SECOND_CONTEXTS + second, near = 0, eighths = 0;
  if (absolute) {
    eighths = (8 * mean + ((1 << shift) >> 1)) >> shift;
    near = (eighths + 4) >> 3;
    eighths -= 8 * near;
  }
  int32_t steps = symbol(mixtures + scales[context], eighths), size = steps < 0 ? -steps : steps;
  running = (running + 16 * smaller(size, 1 << 14)) >> 1;
  // at most 2^24 steps of at most 2^14: more than 32 bits, but all values are clipped to fewer
  int64_t value = ((int64_t)(near + steps) << shift) + (absolute ? 0 : mean);
  return value > NONE ? NONE : value < -NONE ? -NONE : (int32_t)value;
}

static void read_axis(int64_t *row, int32_t *stored, int32_t primary, int32_t shift) {
  predict_axis(primary);
  int32_t pole = 0;
  for (int32_t a = 1; a < 3; a++)
    if (magnitude(axis[a]) > magnitude(axis[pole])) pole = a;
  double side = axis[pole] < 0 ? -1 : 1;
  int32_t first = (pole + 1) % 3, second = (pole + 2) % 3;
  double norm = magnitude(axis[0]) + magnitude(axis[1]) + magnitude(axis[2]);
  double p = side * axis[first], q = side * axis[second];
  if (!absolute) {
    double sum = p + q;
    q = p - q;
    p = sum;
  }
  int32_t spread = spread_context(axis_count, axis_deviation, shift);
  int32_t x = clip(value_of(4, spread, (int32_t)__builtin_floor(p * ONE / norm), shift), -ONE, ONE);
  int32_t most = absolute ? ONE - (x < 0 ? -x : x) : ONE;
  int32_t y = clip(value_of(4, spread, (int32_t)__builtin_floor(q * ONE / norm), shift), -most, most);
  if (!absolute) {
    int32_t sum = x + y;
    y = (x - y) >> 1;
    x = sum >> 1;
  }
  int32_t found[3], rest = ONE - (x < 0 ? -x : x) - (y < 0 ? -y : y);
  found[first] = x, found[second] = y, found[pole] = rest > 0 ? rest : 0;
  if (absolute) {
    int32_t sizes[3], top = 0;
    for (int32_t a = 0; a < 3; a++) sizes[a] = found[a] < 0 ? -found[a] : found[a];
    for (int32_t a = 1; a < 3; a++)
      if (sizes[a] > sizes[top]) top = a;
    if (found[top] < 0)
      for (int32_t a = 0; a < 3; a++) found[a] = -found[a];
  }
  for (int32_t a = 0; a < 3; a++) row[AXIS + a] = stored[a] = found[a];
  row[PRIMARY] = stored[3] = primary;
}

static void read_harmonics(int32_t *found, int32_t number, int32_t level, int32_t shift) {
  if (!bit(FIRST_HARMONIC + level)) {
    for (int32_t j = 0; j < number; j++) found[j] = 0;
    return;
  }
  int32_t recent = 0;
  for (int32_t j = 0; j < number; j++) {
    int32_t group = j < 3 ? 0 : j < 9 ? 1 : j < 21 ? 2 : 3, context = 0, size = 0, negative = 0;
    while (context < 7 && recent >= running_bounds[context]) context++;
    if (bit(FIRST_HARMONIC + 8 + (context * 4 + group) * 2 + (j % 3 ? 1 : 0))) {
      negative = (int32_t)raw(1);
      int32_t base = FIRST_MAGNITUDE + context * 3;
      for (size = 1; size < 15 && bit(base + smaller(size - 1, 2)); size++) continue;
      if (size == 15) {
        uint64_t more = gamma_code();
        size += more > 1 << 20 ? 1 << 20 : (int32_t)more;
      }
    }
    int32_t value = clip(size << shift, 0, MAX_HARMONIC);
    found[j] = negative ? -value : value;
    recent = ((recent * 13) >> 4) + smaller(size, 65536) * 16;
  }
}

static void read_gaussian(uint32_t i, int64_t *row, int32_t start, int32_t box_bits, int32_t lattice_bits,
                          int32_t max_position_shift) {
  double *own = values + PREDICTED * i;
  int32_t class_context = predict(), node = 1;
  for (int32_t b = 0; b < 3; b++) node = 2 * node + bit(FIRST_CLASS + 8 * class_context + node);
  int32_t level = node - 8, found[4] = {0, 0, 0, 0}, thin = 0, area = 0;
  row[CLASS] = own[7] = level;
  running = 16;
  for (int32_t stream = 0; stream < 4; stream++) {
    int32_t s0 = found[1], length = found[2], low = 0, high = MAX_LOG, most = BITS - 1;
    area = 0;
    if (stream == 0) low = -(10 << BITS), high = -1, most = BITS;
    else if (stream == 1) area = absolute ? 0 : 2 * means[1] - (2 << BITS), low = -MAX_LOG;
    else area = stream == 2 ? 2 * s0 - (2 << BITS) : 2 * s0 - length;
    int32_t shift = clip(BITS - exponent(stream, level, area, length, 0, found[0]), 0, most);
    int32_t spread = spread_context(num_near, deviations[stream], shift);
    int32_t value = value_of(stream, spread, means[stream], shift);
    if (stream == 3) high = absolute ? (MAX_COMPANDED >> shift) << shift : MAX_COMPANDED;
    row[OPACITY + stream] = own[stream] = found[stream] = clip(value, low, high);
  }
  int32_t opacity = found[0], s0 = found[1], length = found[2];
  thin = thinness[found[3]];
  area = 2 * s0 - length;
  int32_t finest = exponent(S_POSITION, level, area, length, thin, opacity), least = 1 - ((s0 - length) >> BITS);
  if (least > finest) finest = least;
  int32_t shift = clip(lattice_bits - finest, 0, absolute ? max_position_shift : box_bits);
  int32_t fine = smaller(start, shift);
  for (int32_t a = 0; a < 3; a++) {
    uint64_t place = (uint64_t)cells[a * count + i] << (start - fine) | raw(start - fine);
    int32_t size = absolute ? shift : fine;
    row[LATTICE + a] = (int64_t)((place >> (size - fine)) << (size + 1) | 1ULL << size);
  }
  int32_t primary = thin >= length ? 2 : 0;
  shift = clip(DIRECTION_BITS - exponent(S_DIRECTION, level, area, length, thin, opacity), 0, DIRECTION_BITS - 2);
  read_axis(row, axes + 4 * i, primary, shift);
  int32_t bits = clip(exponent(S_SPIN, level, area, length, thin, opacity), 0, DIRECTION_BITS);
  row[SPIN_BITS] = bits;
  row[SPIN] = (int64_t)raw(bits);
  shift = clip(BITS - exponent(S_COLOUR, level, 0, 0, 0, 0), 0, BITS - 2);
  for (int32_t c = 0; c < 3; c++) {
    int32_t spread = spread_context(num_near, deviations[4 + c], shift);
    row[LUMA + c] = own[4 + c] = clip(value_of(5 + c, spread, means[4 + c], shift), -MAX_COLOUR, MAX_COLOUR);
  }
}

// Conversion to floating point; see `src/codec/gaussians/to_splats.ts`. The operations are the same, in the same order.

__attribute__((import_module("math"), import_name("sin"))) double sine(double);
__attribute__((import_module("math"), import_name("cos"))) double cosine(double);

// Cosines and sines of the spins of up to `TURN_BITS` bits, those of `n` bits from index `1 << n` on.
#define TURN_BITS 8
static double turns[4 << TURN_BITS];
static int64_t *decoded_rows;
static int32_t *decoded_harmonics;
static uint32_t floats_at;

static double power_of_two(int32_t log) {
  return fractions[log & ((1 << BITS) - 1)] * wholes[(log >> BITS) + OCTAVES];
}

// Writes the colours of two orthonormal Y Co Cg, or only the first one.
INLINE void write_rgb(float *out, v128_t y, v128_t co, v128_t cg, int32_t both) {
  y = wasm_f64x2_div(y, wasm_f64x2_const_splat(R3));
  co = wasm_f64x2_div(co, wasm_f64x2_const_splat(R2));
  cg = wasm_f64x2_div(cg, wasm_f64x2_const_splat(R6));
  v128_t red = wasm_f32x4_demote_f64x2_zero(wasm_f64x2_sub(wasm_f64x2_add(y, co), cg));
  v128_t green = wasm_f32x4_demote_f64x2_zero(wasm_f64x2_add(y, wasm_f64x2_add(cg, cg)));
  v128_t blue = wasm_f32x4_demote_f64x2_zero(wasm_f64x2_sub(wasm_f64x2_sub(y, co), cg));
  v128_t pairs = wasm_i32x4_shuffle(red, green, 0, 4, 1, 5);
  wasm_v128_store64_lane(out, pairs, 0);
  wasm_v128_store32_lane(out + 2, blue, 0);
  if (!both) return;
  wasm_v128_store64_lane(out + 3, pairs, 1);
  wasm_v128_store32_lane(out + 5, blue, 1);
}

static void set_turn(double *turn, int32_t bits, uint32_t spin) {
  double angle = spin * PI / (1u << bits);
  turn[0] = cosine(angle);
  turn[1] = sine(angle);
}

// `m` has the columns of the rotation matrix, one after another.
static void write_quaternion(float *out, const double *m) {
  double xx = m[0], yx = m[1], zx = m[2], xy = m[3], yy = m[4], zy = m[5], xz = m[6], yz = m[7], zz = m[8];
  double trace = xx + yy + zz, w = 1 + trace, x = zy - yz, y = xz - zx, z = yx - xy;
  if (trace < xx || trace < yy || trace < zz) {
    if (xx >= yy && xx >= zz) w = x, x = 1 + 2 * xx - trace, y = yx + xy, z = zx + xz;
    else if (yy >= zz) w = y, x = yx + xy, y = 1 + 2 * yy - trace, z = zy + yz;
    else w = z, x = zx + xz, y = zy + yz, z = 1 + 2 * zz - trace;
  }
  double size = __builtin_sqrt(w * w + x * x + y * y + z * z);
  out[0] = (float)(w / size), out[1] = (float)(x / size), out[2] = (float)(y / size), out[3] = (float)(z / size);
}

static void write_rotation(float *out, const int64_t *row) {
  double ax = row[AXIS], ay = row[AXIS + 1], az = row[AXIS + 2], length = __builtin_sqrt(ax * ax + ay * ay + az * az);
  if (!(length > 0)) length = 1;
  double ux = ax / length, uy = ay / length, uz = az / length;
  double sx = magnitude(ux), sy = magnitude(uy), sz = magnitude(uz);
  int32_t least = sy < sx ? (sz < sy ? 2 : 1) : sz < sx ? 2 : 0;
  double dot = least == 0 ? ux : least == 1 ? uy : uz;
  double tx = (least == 0) - dot * ux, ty = (least == 1) - dot * uy, tz = (least == 2) - dot * uz;
  const double *turn = turns + 2 * ((1u << row[SPIN_BITS]) + (uint32_t)row[SPIN]);
  double unknown[2];
  if (row[SPIN_BITS] > TURN_BITS) {
    set_turn(unknown, (int32_t)row[SPIN_BITS], (uint32_t)row[SPIN]);
    turn = unknown;
  }
  double norm = __builtin_sqrt(tx * tx + ty * ty + tz * tz), c = turn[0] / norm, s = turn[1] / norm;
  double vx = c * tx + s * (uy * tz - uz * ty), vy = c * ty + s * (uz * tx - ux * tz);
  double vz = c * tz + s * (ux * ty - uy * tx), axes[9];
  int32_t first = 3 * (int32_t)row[PRIMARY], second = (first + 3) % 9, third = (first + 6) % 9;
  axes[first] = ux, axes[first + 1] = uy, axes[first + 2] = uz;
  axes[second] = vx, axes[second + 1] = vy, axes[second + 2] = vz;
  axes[third] = uy * vz - uz * vy, axes[third + 1] = uz * vx - ux * vz, axes[third + 2] = ux * vy - uy * vx;
  write_quaternion(out, axes);
}

// `number` is the number of harmonics of a colour channel. Most of `numbers` are 0. All sums are exact.
static void write_harmonics(float *out, const int32_t *numbers, int32_t number) {
  v128_t sums[3][MOST_HARMONICS / 2] = {{{0}}};
  int32_t empty = 1;
  for (int32_t k = 0; k < number; k++, numbers += 3) {
    if (!(numbers[0] | numbers[1] | numbers[2])) continue;
    empty = 0;
    const double *shares = transform + MOST_HARMONICS * k;
    v128_t y = wasm_f64x2_splat(numbers[0]), co = wasm_f64x2_splat(numbers[1]), cg = wasm_f64x2_splat(numbers[2]);
    for (int32_t b = 0; 2 * b < number; b++) {
      v128_t share = wasm_v128_load(shares + 2 * b);
#define ADD(sum, value) sum = wasm_f64x2_add(sum, wasm_f64x2_mul(value, share))
      ADD(sums[0][b], y);
      ADD(sums[1][b], co);
      ADD(sums[2][b], cg);
    }
  }
  if (empty) {
    for (int32_t n = 0; n < 3 * number; n++) out[n] = 0;
    return;
  }
  v128_t unit = wasm_f64x2_const_splat((1 << BITS) * TRANSFORM_UNIT);
  for (int32_t b = 0; 2 * b < number; b++, out += 6)
    write_rgb(out, wasm_f64x2_div(sums[0][b], unit), wasm_f64x2_div(sums[1][b], unit), wasm_f64x2_div(sums[2][b], unit),
              2 * b + 1 < number);
}

/// Converts the last decoded packet to floating point. Returns the address of its centres, followed by rotations,
/// scales, opacities, colours and harmonics. `half` is half the lattice spacing, `size` the scene's unit of length.
EXPORT(convert) uint32_t convert(uint32_t number, uint32_t harmonics, double half, double size) {
  reserve(floats_at + 4 * (14 + harmonics) * number);
  float *centres = (float *)floats_at, *rotations = centres + 3 * number, *sizes = rotations + 4 * number;
  float *opacities = sizes + 3 * number, *colours = opacities + number, *rest = colours + 3 * number;
  const int64_t *row = decoded_rows;
  for (uint32_t i = 0; i < number; i++, row += COLUMNS) {
    for (int32_t a = 0; a < 3; a++) centres[3 * i + a] = (float)((2 * corner[a] + row[LATTICE + a]) * half);
    int32_t s0 = (int32_t)row[SCALE0], s1 = s0 - (int32_t)row[SCALE0 + 1];
    sizes[3 * i] = (float)(size * power_of_two(s0));
    sizes[3 * i + 1] = (float)(size * power_of_two(s1));
    sizes[3 * i + 2] = (float)(size * power_of_two(s1 - thinness[(int32_t)row[SCALE0 + 2]]));
    opacities[i] = (float)power_of_two((int32_t)row[OPACITY]);
    const double unit = 1 << BITS;
    write_rgb(colours + 3 * i, wasm_f64x2_splat(row[LUMA] / unit), wasm_f64x2_splat(row[LUMA + 1] / unit),
              wasm_f64x2_splat(row[LUMA + 2] / unit), 0);
    write_rotation(rotations + 4 * i, row);
    if (harmonics)
      write_harmonics(rest + harmonics * i, decoded_harmonics + harmonics * i, (int32_t)(harmonics / 3));
  }
  return floats_at;
}

/// Converts the integers of the last packet's `number` Gaussians to doubles in place. `convert` must come before it.
EXPORT(widen) void widen(uint32_t number) {
  for (uint32_t n = 0; n < COLUMNS * number; n++) ((double *)decoded_rows)[n] = (double)decoded_rows[n];
}

/// Computes the distributions of the stream's contexts and `thinness`, once all tables but `defaults` are filled.
EXPORT(prepare) void prepare(void) {
  for (int32_t log = 0, t = 1; t <= MAX_COMPANDED; log++)
    for (double most = (1 - power_of_two(-log)) * ((1 << BITS) / LN2); t <= most && t <= MAX_COMPANDED;) thinness[t++] = log;
  for (int32_t bits = 0; bits <= TURN_BITS; bits++)
    for (uint32_t spin = 0; spin < 1u << bits; spin++) set_turn(turns + 2 * ((1u << bits) + spin), bits, spin);
  heap_end = ((uint32_t)&__heap_base + 15) & ~15u;
  for (int32_t scale = 0; scale < NUM_SCALES; scale++) mixtures[scale].stride = 0;
  for (int32_t c = 0; c < CONTEXTS; c++) {
    Mixtures *own = mixtures + scales[c];
    if (own->stride) continue;
    own->scale = scales[c], own->half = half_width(scales[c]), own->shift = 0;
    while ((2 * own->half >> own->shift) >= MOST_BOUNDS) own->shift++;
    own->guess_bits = smaller(bits_of((uint32_t)own->half) + 1, MOST_GUESS_BITS);
    own->stride = (2 * own->half >> own->shift) + 2;
    uint32_t guesses = MEANS << own->guess_bits;
    reserve(heap_end + 2 * guesses + 4 * MEANS * own->stride);
    uint16_t *guess = (uint16_t *)heap_end;
    int32_t *bound = (int32_t *)(heap_end + 2 * guesses);
    own->guesses = guess, own->bounds = bound;
    for (int32_t mean = -4; mean < 4; mean++, guess += 1 << own->guess_bits, bound += own->stride)
      tabulate(own, mean, guess, bound);
    heap_end += 2 * guesses + 4 * MEANS * own->stride;
  }
}

/// Returns the address for a payload of `bytes` bytes.
EXPORT(begin) uint32_t begin(uint32_t bytes) {
  if (!heap_end) heap_end = ((uint32_t)&__heap_base + 15) & ~15u;
  reserve(heap_end + bytes);
  return heap_end;
}

/// Counts the elements of each of `number` lanes among `size` elements from `first` on; see `src/packets/plan.ts`.
/// Returns the address of the counts, int32.
EXPORT(lanes) uint32_t lanes(uint32_t first, uint32_t size, uint32_t low, uint32_t high, uint32_t number) {
  int32_t *counts = (int32_t *)begin(4 * number);
  for (uint32_t n = 0; n < number; n++) counts[n] = 0;
  for (uint32_t end = first + size; first < end; first++) {
    uint64_t z = ((uint64_t)high << 32 | (first ^ low)) + 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    counts[(z ^ z >> 31) % number]++;
  }
  return heap_end;
}

/// Updates the state of SHA-256 (FIPS 180-4) with `blocks` blocks of 64 bytes. At `begin` lie the 8 words of the state, the
/// 64 constants of the rounds, and the blocks. Four blocks at a time are expanded, one in each lane, because only the
/// rounds depend on the blocks before; up to three blocks behind the last one are read.
EXPORT(hash) void hash(uint32_t blocks) {
  static v128_t words[64];
  uint32_t *state = (uint32_t *)heap_end;
  const uint32_t *constants = state + 8, *at = constants + 64;
  for (int32_t left = (int32_t)blocks; left > 0; left -= 4, at += 64) {
    for (int32_t t = 0; t < 16; t++) {
      v128_t word = wasm_i32x4_make(at[t], at[t + 16], at[t + 32], at[t + 48]);
      words[t] = wasm_i8x16_shuffle(word, word, 3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12);
    }
    for (int32_t t = 16; t < 64; t++) {
      v128_t x = words[t - 15], y = words[t - 2];
      words[t] = words[t - 16] + (TURNED(x, 7) ^ TURNED(x, 18) ^ wasm_u32x4_shr(x, 3)) + words[t - 7] +
                 (TURNED(y, 17) ^ TURNED(y, 19) ^ wasm_u32x4_shr(y, 10));
    }
    for (int32_t n = 0; n < 4 && n < left; n++) {
      const uint32_t *word = (const uint32_t *)words + n;
      uint32_t a = state[0], b = state[1], c = state[2], d = state[3];
      uint32_t e = state[4], f = state[5], g = state[6], h = state[7];
      for (int32_t t = 0; t < 64; t++) {
        uint32_t sum = h + (ROTATED(e, 6) ^ ROTATED(e, 11) ^ ROTATED(e, 25)) + (g ^ (e & (f ^ g)));
        uint32_t other = (ROTATED(a, 2) ^ ROTATED(a, 13) ^ ROTATED(a, 22)) + ((a & b) | (c & (a | b)));
        sum += constants[t] + word[4 * t];
        h = g, g = f, f = e, e = d + sum, d = c, c = b, b = a, a = sum + other;
      }
      state[0] += a, state[1] += b, state[2] += c, state[3] += d;
      state[4] += e, state[5] += f, state[6] += g, state[7] += h;
    }
  }
}

/// Decodes a packet of `number` Gaussians with `harmonics` harmonics each from the payload at `begin`. Returns the
/// address of `COLUMNS` 64-bit integers for each Gaussian. The harmonics follow them.
EXPORT(decode) uint32_t decode(
    uint32_t bytes, uint32_t number, uint32_t harmonics, int32_t box_bits, int32_t lattice_bits,
    int32_t max_position_shift) {
  uint32_t rows_at = (heap_end + bytes + 15) & ~15u, harmonics_at = rows_at + 8 * COLUMNS * number;
  uint32_t values_at = (harmonics_at + 4 * harmonics * number + 15) & ~15u;
  uint32_t axes_at = values_at + 8 * PREDICTED * number, codes_at = axes_at + 16 * number;
  uint32_t cells_at = codes_at + 8 * number;
  reserve(cells_at + 20 * number + 12 * WINDOW + ZEROS + bytes);
  narrow_xy = (int32_t *)(cells_at + 12 * number + 4 * WINDOW);
  narrow_z = narrow_xy + number + WINDOW;
  decoded_rows = (int64_t *)rows_at;
  decoded_harmonics = (int32_t *)harmonics_at;
  floats_at = values_at;  // what lies there is not needed after the packet is decoded
  values = (double *)values_at;
  axes = (int32_t *)axes_at;
  codes = (uint64_t *)codes_at;
  cells = (int32_t *)cells_at;
  count = number;
  absolute = max_position_shift >= 0;
  for (int32_t i = 0; i < 2 * NUM_CONTEXTS; i++) models[i] = initial[i];
  start_decoder(bytes, (uint8_t *)(narrow_z + number + WINDOW));
  int32_t least = box_bits - 21, start = clip((int32_t)raw(6), least > 0 ? least : 0, box_bits);
  read_cells(box_bits - start);
  if (box_bits - start <= NARROW_BITS) {
    for (uint32_t i = 0; i < WINDOW; i++) narrow_xy[i] = NOWHERE, narrow_z[i] = 0;
    for (uint32_t i = 0; i < number; i++) {
      narrow_xy[WINDOW + i] = cells[i] | cells[number + i] << 16;
      narrow_z[WINDOW + i] = cells[2 * number + i];
    }
  }
  for (uint32_t i = 0; i < number; i++) {
    if (box_bits - start <= NARROW_BITS) find_narrow(i);
    else find_wide(i);
    read_gaussian(i, decoded_rows + COLUMNS * i, start, box_bits, lattice_bits, max_position_shift);
    if (harmonics) {
      int32_t level = (int32_t)values[PREDICTED * i + 7];
      int32_t shift = clip(BITS - exponent(S_HARMONICS, level, 0, 0, 0, 0), 0, BITS - 2);
      read_harmonics((int32_t *)harmonics_at + harmonics * i, (int32_t)harmonics, level, shift);
    }
  }
  return rows_at;
}

// Motion; see `src/codec/tracks/motion.ts`, `predict.ts` and `trajectories.ts`.

#define CHANNELS 13
#define KINDS 5
#define HEAD 6
#define MOVING 1
#define MAX_FRAMES 64
#define MAX_CANDIDATES 4096
#define LEVELS 10
#define ORDERS 8
#define MAGNITUDES 16
#define MAX_OCTAVE 29
#define MAX_LEAD (1 << 24)
#define NEAREST 8
#define WEIGHT 4096
#define AWAY 0x1p60f  // above all squared distances
#define MAX_COEFFICIENT 0x1p36

enum { TRACK, STATE, BEGINS, ENDS, BEFORE, AFTER };
enum { C_GONE = 0, C_MOVING = 2, C_ENDS = 6, C_BEGINS = 7, C_ZERO = 8, C_OCTAVE = 408 };

// Tables that the caller fills: units of the channels, polynomials with one row of `MAX_FRAMES` values per degree, and
// the models of a packet's start.
struct {
  double units[CHANNELS + 1], polynomials[MAX_FRAMES * MAX_FRAMES];
  int32_t models[2 * MOTION_CONTEXTS];
} motion;

static const uint8_t kind_of[CHANNELS] = {0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4};
static int32_t orders[KINDS], size, stride, *headers, *residuals, num_frames;

static int32_t read_headers(int32_t first_new) {
  int32_t first = (int32_t)raw(28);
  uint64_t gap = gamma_code();
  int32_t before = first - (gap > MAX_LEAD ? MAX_LEAD : (int32_t)gap);
  int32_t end = first + smaller((int32_t)raw(13), MAX_CANDIDATES);
  gap = gamma_code();
  int32_t at = 0, gone = 0, moved = 0;
  for (int32_t track = first; track < end; track++) {
    gone = bit(C_GONE + gone);
    if (gone) continue;
    if (at == (int32_t)count) break;
    int32_t state = bit(C_MOVING + moved), *row = headers + HEAD * at++;
    moved = (moved << 1 | state) & 3;
    row[TRACK] = track;
    row[STATE] = state;
    row[BEGINS] = track >= first_new && bit(C_BEGINS) ? (int32_t)below(num_frames) : 0;
    row[ENDS] = bit(C_ENDS) ? (int32_t)below(num_frames) : num_frames;
    row[BEFORE] = track - before;
    row[AFTER] = 0;
    before = track + 1;
  }
  if (at) headers[HEAD * (at - 1) + AFTER] = gap > MAX_LEAD ? MAX_LEAD : (int32_t)gap;
  return at;
}

static int32_t read_coefficient(int32_t kind, int32_t order, int32_t level) {
  if (!bit(C_ZERO + (kind * ORDERS + smaller(order, ORDERS - 1)) * LEVELS + level)) return 0;
  int32_t base = C_OCTAVE + (kind * LEVELS + level) * MAGNITUDES, octave = 0;
  while (octave < MAX_OCTAVE && bit(base + smaller(octave, MAGNITUDES - 1))) octave++;
  uint32_t value = (1u << octave) + (uint32_t)raw(octave);
  if (value > 0x3fffffff) value = 0x3fffffff;
  return raw(1) ? -(int32_t)value : (int32_t)value;
}

static void read_track(int32_t *row, const int32_t *before) {
  int32_t greatest = 0;
  for (int32_t c = 0, at = 0; c < CHANNELS; c++) {
    int32_t kind = kind_of[c], first = !c || kind_of[c - 1] != kind, own = 0;
    if (first) {
      greatest = 0;
      if (before && orders[kind]) own = __builtin_abs(before[at]);
    }
    for (int32_t k = 0; k < orders[kind]; k++, at++) {
      uint32_t near = larger(own, greatest), side = first ? 0 : 2 * (uint32_t)__builtin_abs(row[at - orders[kind]]);
      if (side > near) near = side;
      int32_t value = row[at] = read_coefficient(kind, k, smaller(bits_of(near), LEVELS - 1));
      own = k == 0 && first ? __builtin_abs(value) : larger(own, __builtin_abs(value));
    }
    greatest = larger(greatest, own);
  }
}

/// Decodes the headers and residuals of a packet of `number` tracks over `frames` frames from the payload at `begin`.
/// Returns the address of the headers. Behind them lies room for shifts, int32 (number, 13), for places, double
/// (number, 3), at a multiple of 8, and for an order, int32 (number).
EXPORT(readMotion) uint32_t read_motion(uint32_t bytes, uint32_t number, int32_t frames, int32_t first_new) {
  uint32_t headers_at = (heap_end + bytes + 15) & ~15u;
  uint32_t places_at = (headers_at + 4 * (HEAD + CHANNELS) * number + 7) & ~7u;
  uint32_t reversed_at = places_at + 28 * number, residuals_at = (reversed_at + ZEROS + bytes + 7) & ~7u;
  reserve(residuals_at);
  headers = (int32_t *)headers_at;
  residuals = (int32_t *)residuals_at;
  count = number;
  num_frames = frames;
  for (int32_t i = 0; i < 2 * MOTION_CONTEXTS; i++) models[i] = motion.models[i];
  for (uint32_t i = 0; i < HEAD * number; i++) headers[i] = -1;
  start_decoder(bytes, (uint8_t *)reversed_at);
  int32_t found = read_headers(first_new);
  for (int32_t kind = 0; kind < KINDS; kind++) orders[kind] = (int32_t)below(frames + 1);
  size = 3 * (orders[0] + orders[1] + orders[2] + orders[4]) + orders[3];
  stride = (size + 1) & ~1;
  reserve(residuals_at + 4 * size * number);
  int32_t *before = 0;
  for (int32_t i = 0; i < found; i++) {
    if (headers[HEAD * i + STATE] != MOVING) continue;
    read_track(residuals + i * size, before);
    before = residuals + i * size;
  }
  return headers_at;
}

static double *places, *rows_of;
static float *known;  // coordinates of the known tracks in their sequence, one axis after another
static uint32_t num_known, padded;

static void add_known(uint32_t i) {
  for (int32_t a = 0; a < 3; a++) known[a * padded + num_known] = (float)places[3 * i + a];
  axes[num_known++] = (int32_t)i;
}

// Positions of the nearest tracks in the sequence of known tracks, nearest first, and their squared distances.
static uint32_t nearest[NEAREST];
static double squares[NEAREST];
static float *apart;  // rounded squared distances of the known tracks

static int32_t find_known(uint32_t i) {
  const double *place = places + 3 * i;
  v128_t xyz[3], least[2], most;
  for (int32_t a = 0; a < 3; a++) xyz[a] = wasm_f32x4_splat((float)place[a]);
  least[0] = least[1] = wasm_f32x4_const_splat(AWAY * AWAY * 4);
  for (uint32_t n = 0; n < num_known; n += 4) {
    const float *at = known + n;
    v128_t x = wasm_f32x4_sub(wasm_v128_load(at), xyz[0]), y = wasm_f32x4_sub(wasm_v128_load(at + padded), xyz[1]);
    v128_t z = wasm_f32x4_sub(wasm_v128_load(at + 2 * padded), xyz[2]);
    v128_t d = wasm_f32x4_add(wasm_f32x4_add(wasm_f32x4_mul(x, x), wasm_f32x4_mul(y, y)), wasm_f32x4_mul(z, z));
    wasm_v128_store(apart + n, d);  // differences are exact, squares are rounded
    most = wasm_f32x4_pmin(least[0], d);
    least[1] = wasm_f32x4_pmin(least[1], wasm_f32x4_pmax(least[0], d));
    least[0] = most;
  }
  // The second least of each lane: eight tracks are at most as far as the farthest of these.
  most = wasm_f32x4_pmax(least[1], wasm_i32x4_shuffle(least[1], least[1], 1, 0, 3, 2));
  most = wasm_f32x4_mul(wasm_f32x4_pmax(most, wasm_i32x4_shuffle(most, most, 2, 3, 0, 1)), wasm_f32x4_const_splat(1.000001f));
  int32_t found = 0;
  for (uint32_t n = 0; n < num_known; n += 4) {
    for (uint32_t near = wasm_i32x4_bitmask(wasm_f32x4_le(wasm_v128_load(apart + n), most)); near; near &= near - 1) {
      uint32_t position = n + (uint32_t)__builtin_ctz(near);
      if (position >= num_known) break;
      double square = 0;
      for (int32_t a = 0; a < 3; a++) {
        double axis = known[a * padded + position] - place[a];
        square += axis * axis;
      }
      int32_t m = found;
      if (found < NEAREST) found++;
      else if (square >= squares[--m]) continue;
      for (; m > 0 && squares[m - 1] > square; m--) squares[m] = squares[m - 1], nearest[m] = nearest[m - 1];
      squares[m] = square, nearest[m] = position;
    }
  }
  return found;
}

// Weights of the nearest tracks in the plane fit.
static double plane_weights[NEAREST];

static void fit_plane(uint32_t i, int32_t found) {
  double o[3 * NEAREST], near[NEAREST], radius = 1, total = 0, sums[3] = {0}, m[6] = {0};
  for (int32_t n = 0; n < found; n++) {
    for (int32_t a = 0; a < 3; a++) {
      o[3 * n + a] = places[3 * axes[nearest[n]] + a] - places[3 * i + a];
      if (magnitude(o[3 * n + a]) > radius) radius = magnitude(o[3 * n + a]);
    }
  }
  for (int32_t n = 0; n < found; n++) {
    double w = near[n] = 1 + __builtin_floor(2 * (squares[0] + 1) / (squares[n] + 1));
    total += w;
    for (int32_t a = 0; a < 3; a++) {
      o[3 * n + a] = __builtin_floor(o[3 * n + a] * 1024 / radius);
      sums[a] += w * o[3 * n + a];
    }
    for (int32_t a = 0, at = 0; a < 3; a++)
      for (int32_t b = a; b < 3; b++) m[at++] += w * o[3 * n + a] * o[3 * n + b];
  }
  for (int32_t a = 0, at = 0; a < 3; a++)
    for (int32_t b = a; b < 3; b++, at++) m[at] = total * m[at] - sums[a] * sums[b];
  double trace = m[0] + m[3] + m[5], spread = 1, pull = 1, most = 0, h[3];
  while (__builtin_floor(trace / spread) >= 65536) spread *= 2;
  double ridge = __builtin_floor(trace / (spread * 16384)) + 4;
  for (int32_t n = 0; n < 6; n++) m[n] = __builtin_floor(m[n] / spread) + (n == 0 || n == 3 || n == 5 ? ridge : 0);
  double a = m[3] * m[5] - m[4] * m[4], b = m[2] * m[4] - m[1] * m[5], c = m[1] * m[4] - m[2] * m[3];
  double d = m[0] * m[5] - m[2] * m[2], e = m[1] * m[2] - m[0] * m[4], g = m[0] * m[3] - m[1] * m[1];
  double determinant = m[0] * a + m[1] * b + m[2] * c;
  if (determinant < 1) determinant = 1;
  h[0] = a * sums[0] + b * sums[1] + c * sums[2];
  h[1] = b * sums[0] + d * sums[1] + e * sums[2];
  h[2] = c * sums[0] + e * sums[1] + g * sums[2];
  for (int32_t n = 0; n < 3; n++) most = magnitude(h[n]) > most ? magnitude(h[n]) : most;
  while (__builtin_floor(most / pull) >= 0x1p33) pull *= 2;
  for (int32_t n = 0; n < 3; n++) h[n] = __builtin_floor(h[n] / pull);
  double scale = 0x1p20 * pull / spread;
  for (int32_t n = 0; n < found; n++) {
    double moment = h[0] * (total * o[3 * n] - sums[0]) + h[1] * (total * o[3 * n + 1] - sums[1]) +
                    h[2] * (total * o[3 * n + 2] - sums[2]);
    double turn = __builtin_floor(moment / determinant * scale + 0.5);
    double share = __builtin_floor(near[n] * (0x1p20 - turn) / (total * (0x1p20 / WEIGHT)));
    plane_weights[n] = share < -WEIGHT ? -WEIGHT : share > WEIGHT ? WEIGHT : share;
  }
}

static void predict_track(uint32_t i, const int32_t *shifts) {
  int32_t found = find_known(i);
  double left = WEIGHT, *own = rows_of + i * stride;
  for (int32_t m = 0; m < found; m++) plane_weights[m] = __builtin_floor((double)WEIGHT / found);
  if (found >= 4) fit_plane(i, found);
  for (int32_t m = 0; m < found; m++) left -= plane_weights[m];
  if (found) plane_weights[0] += left;
  int32_t some = 0;
  const double *rows[NEAREST];
  v128_t weights_of[NEAREST];
  for (int32_t m = 0; m < found; m++) {
    int32_t j = axes[nearest[m]];
    if (headers[HEAD * j + STATE] != MOVING) continue;
    rows[some] = rows_of + j * stride;
    weights_of[some++] = wasm_f64x2_splat(plane_weights[m]);
  }
  for (int32_t u = 0; u < stride; u += 2) {
    v128_t sum = wasm_f64x2_splat(0);
    for (int32_t m = 0; m < some; m++)
      sum = wasm_f64x2_add(sum, wasm_f64x2_mul(weights_of[m], wasm_v128_load(rows[m] + u)));
    wasm_v128_store(own + u, sum);
  }
  for (int32_t c = 0, u = 0; c < CHANNELS; c++) {
    double step = 1u << shifts[CHANNELS * i + c];
    for (int32_t k = 0; k < orders[kind_of[c]]; k++, u++) {
      double value = __builtin_floor((own[u] + WEIGHT / 2) / WEIGHT) + residuals[i * size + u] * step;
      own[u] = value < -MAX_COEFFICIENT ? -MAX_COEFFICIENT : value > MAX_COEFFICIENT ? MAX_COEFFICIENT : value;
    }
  }
}

// Writes the offsets of a track. Its frames are `row` numbers apart.
static void write_offsets(const double *own, float *out, uint32_t row) {
  int32_t colour = 0;
  for (int32_t c = 0; c < CHANNELS; own += orders[kind_of[c++]]) {
    int32_t end = orders[kind_of[c]];
    while (end && own[end - 1] == 0) end--;
    if (!end) continue;
    colour |= kind_of[c] == KINDS - 1;
    for (int32_t f = 0; f < num_frames; f += 2) {
      v128_t sum = wasm_f64x2_splat(0);
      for (int32_t k = 0; k < end; k++) {
        v128_t values = wasm_v128_load(motion.polynomials + MAX_FRAMES * k + f);
        sum = wasm_f64x2_add(sum, wasm_f64x2_mul(wasm_f64x2_splat(own[k]), values));
      }
      sum = wasm_f32x4_demote_f64x2_zero(wasm_f64x2_mul(sum, wasm_f64x2_splat(motion.units[c])));
      out[row * f + c] = wasm_f32x4_extract_lane(sum, 0);
      if (f + 1 < num_frames) out[row * (f + 1) + c] = wasm_f32x4_extract_lane(sum, 1);
    }
  }
  if (!colour) return;
  for (int32_t f = 0; f < num_frames; f++, out += row) {
    double y = out[10] / R3, co = out[11], cg = out[12];
    out[10] = (float)(y + co / R2 - cg / R6);
    out[11] = (float)(y + 2 * cg / R6);
    out[12] = (float)(y - co / R2 - cg / R6);
  }
}

/// Computes the offsets of the packet's tracks, float (frames, number, 13), from the shifts and places behind its
/// headers, and the coding order of `num_moving` tracks behind them, int32. Returns their address.
EXPORT(offsets) uint32_t offsets(uint32_t num_moving) {
  const int32_t *shifts = headers + HEAD * count;
  places = (double *)(((uint32_t)(shifts + CHANNELS * count) + 7) & ~7u);
  const int32_t *order = (int32_t *)(places + 3 * count);
  uint32_t rows_at = ((uint32_t)(residuals + size * count) + 15) & ~15u;
  uint32_t known_at = (rows_at + 8 * stride * count + 15) & ~15u;
  padded = (count + 3) & ~3u;
  uint32_t out_at = known_at + 16 * padded + 4 * count, row = CHANNELS * count;
  reserve(out_at + 4 * row * num_frames);
  rows_of = (double *)rows_at, known = (float *)known_at, apart = known + 3 * padded, axes = (int32_t *)(apart + padded);
  for (uint32_t n = 0; n < 3 * padded; n++) known[n] = AWAY;
  num_known = 0;
  for (uint32_t i = 0; i < count; i++)
    if (headers[HEAD * i + STATE] != MOVING) add_known(i);
  for (uint32_t n = 0; n < num_moving; n++) {
    predict_track((uint32_t)order[n], shifts);
    add_known((uint32_t)order[n]);
  }
  __builtin_memset((float *)out_at, 0, 4 * row * num_frames);
  for (uint32_t i = 0; i < count; i++)
    if (headers[HEAD * i + STATE] == MOVING) write_offsets(rows_of + i * stride, (float *)out_at + CHANNELS * i, row);
  return out_at;
}
