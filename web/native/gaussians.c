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
#define ROTATED_LANES(words, bits) (wasm_u32x4_shr(words, bits) | wasm_i32x4_shl(words, 32 - bits))
#define NUM_SCALES 320
#define NUM_MEANS 8
#define NUM_RESIDUAL_CONTEXTS (8 * NUM_DEVIATION_CONTEXTS * NUM_MAGNITUDE_CONTEXTS)
#define NUM_DEVIATION_CONTEXTS 12
#define NUM_MAGNITUDE_CONTEXTS 16
#define COLUMNS 17
#define WINDOW 64
#define NUM_NEIGHBOURS 6
#define PREDICTED 8
#define PAIRS (PREDICTED / 2)
#define MAX_KEY 0x7fffffff
#define DISTANCE_LIMIT ((1 << 25) - 1)      // above all squared distances of narrow cells
#define PADDING_CELL (-30000 & 0xffff)      // x before the first Gaussian; the square of its distance fits
#define NARROW_BITS 11
#define TOTAL (1 << 24)
#define ESCAPE 16
#define MAX_GUESS_BITS 8
#define MAX_STORED_INTERVALS 512  // of a distribution; wider distributions store every second, fourth, ... bound
#define PADDING_BYTES 16          // bytes behind a payload that may be read
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
#define MAX_HARMONICS 16  // of a colour channel, rounded up to an even number
#define TRANSFORM_UNIT 127
#define PI 3.141592653589793
#define LN2 0.6931471805599453
#define R2 1.4142135623730951
#define R3 1.7320508075688772
#define R6 2.449489742783178

enum { POSITION = 0, CLASS = 3, OPACITY = 4, SCALE0 = 5, ELONGATION = 6, FLATNESS = 7, AXIS = 8 };
enum { PRIMARY = 11, SPIN_BITS = 12, SPIN = 13, LUMA = 14 };
enum { STEP_POSITION = 4, STEP_DIRECTION = 5, STEP_SPIN = 6, STEP_COLOUR = 7, STEP_HARMONICS = 8, STEPS = 9 };

// Tables that the caller fills: of the range coder, of the codec, of the stream, and the block's means.
int32_t normal_cdf[2 * 768 + 1], inverse_scales[NUM_SCALES], widths[NUM_SCALES];
int32_t coefficients[4 * STEPS];
int32_t constant_terms[8 * STEPS], scale_indices[NUM_RESIDUAL_CONTEXTS], initial_models[2 * NUM_CONTEXTS];
int32_t block_means[7];
// Tables of the conversion to floating point: powers of two of the fractions of an octave and of whole octaves, the
// transform of the harmonics, with rows of `MAX_HARMONICS` numbers, and the lower corner of the block.
double fractions[1 << BITS], wholes[2 * OCTAVES], transform[MAX_HARMONICS * MAX_HARMONICS], corner[3];

static int32_t flatness_table[MAX_COMPANDED + 1];  // see `src/codec/gaussians/tables.ts`
static int32_t models[2 * MOTION_CONTEXTS];  // of Gaussians or of motion
static const int32_t magnitude_bounds[7] = {2, 6, 13, 24, 42, 74, 135};

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
  for (uint32_t i = 0; i < PADDING_BYTES; i++) reversed[i] = 0;
  for (uint32_t i = 0; i < bytes; i++) reversed[PADDING_BYTES + i] = payload[bytes - 1 - i];
  last = reversed;
  next = reversed + PADDING_BYTES + bytes - 8;
  __builtin_memcpy(&code, next, 8);
  code >>= 16;
  next -= 6;
  span = 1ULL << 48;
}

INLINE uint32_t target(uint64_t unit, uint32_t max_value) {
  uint64_t value = code / unit;
  return value < max_value ? (uint32_t)value : max_value;
}

static int bit(int32_t context) {
  int32_t *model = models + 2 * context, slow = model[0], fast = model[1];
  uint64_t zero_probability = (uint64_t)clip((slow + fast) >> 1, 32, 65536 - 32), unit = span >> 16;
  if (code >= zero_probability * unit) {
    take(zero_probability * unit, (65536 - zero_probability) * unit);
    model[0] = slow - (slow >> 7);
    model[1] = fast - (fast >> 4);
    return 1;
  }
  take(0, zero_probability * unit);
  model[0] = slow + ((65536 - slow) >> 7);
  model[1] = fast + ((65536 - fast) >> 4);
  return 0;
}

// At most 16 bits.
INLINE uint32_t raw_up_to_16(int32_t bits) {
  uint64_t unit = span >> bits, value = target(unit, (1u << bits) - 1);
  take(unit * value, unit);
  return (uint32_t)value;
}

static uint64_t raw(int32_t bits) {
  uint64_t value = 0;
  while (bits > 0) {
    int32_t num_bits = smaller(bits, 16);
    value = value << num_bits | raw_up_to_16(num_bits);
    bits -= num_bits;
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
  int64_t base = normal_cdf[cell];
  return base + (((normal_cdf[cell + 1] - base) * ((z + Z_LIMIT) & 511)) >> 9);
}

static int32_t max_magnitude_of(int32_t scale_index) { return widths[smaller(scale_index + 24, NUM_SCALES - 1)]; }

static int32_t bound_of(int32_t interval, int32_t scale_index, int32_t mean, int32_t max_magnitude) {
  int32_t count = 2 * max_magnitude + 1;
  if (interval <= 0) return 0;
  if (interval >= count) return TOTAL - ESCAPE;
  int64_t distance = (int64_t)(interval - max_magnitude) * 4096 - 2048 - mean * 512;
  int64_t sum = cdf(distance, inverse_scales[scale_index]) * 45875 +
                cdf(distance, inverse_scales[smaller(scale_index + 24, NUM_SCALES - 1)]) * (65536 - 45875);
  return (int32_t)((((sum >> 16) * (TOTAL - ESCAPE - count)) >> 24) + interval);
}

// Distributions of one scale for all means, one after another: bounds of every `1 << shift`-th symbol's interval, and
// for each position's `guess_bits` high bits the first bound to try. Narrow ones have a `shift` of 0. They are accessed
// at random, so they are kept small enough for the processor's caches.
typedef struct {
  const uint16_t *guesses;
  const int32_t *bounds;
  int32_t stride, max_magnitude, scale_index, shift, guess_bits;
} Distributions;
static Distributions distributions[NUM_SCALES];

static void tabulate(const Distributions *distribution, int32_t mean, uint16_t *guesses, int32_t *bounds) {
  int32_t last = distribution->stride - 1;
  for (int32_t interval = 0; interval <= last; interval++)
    bounds[interval] =
        bound_of(interval << distribution->shift, distribution->scale_index, mean, distribution->max_magnitude);
  for (int32_t guess = 0, interval = 0; guess < 1 << distribution->guess_bits; guess++) {
    while (interval < last - 1 && bounds[interval + 1] <= guess << (24 - distribution->guess_bits)) interval++;
    guesses[guess] = (uint16_t)interval;
  }
}

static int32_t decode_escape(int32_t max_magnitude) {
  uint64_t unit = span >> 24;
  take(unit * (TOTAL - ESCAPE), unit * ESCAPE);
  int is_positive = (int)raw(1);
  uint64_t value = max_magnitude + 1 + gamma_code();
  int32_t num_steps = value > MAX_RESIDUAL ? MAX_RESIDUAL : (int32_t)value;
  return is_positive ? num_steps : -num_steps;
}

// Finds the symbol between two stored bounds, `start` and `after`. The first guess interpolates them.
static int32_t decode_wide(
    const Distributions *distribution, int32_t symbol, int32_t start, int32_t after, int32_t mean, int32_t position) {
  int32_t scale_index = distribution->scale_index, max_magnitude = distribution->max_magnitude;
  int32_t first_symbol = symbol << distribution->shift;
  symbol = first_symbol + (int32_t)(((int64_t)(position - start) << distribution->shift) / (after - start));
  start = bound_of(symbol, scale_index, mean, max_magnitude);
  while (start > position) start = bound_of(--symbol, scale_index, mean, max_magnitude);
  for (;; symbol++, start = after) {
    after = bound_of(symbol + 1, scale_index, mean, max_magnitude);
    if (after > position) break;
  }
  uint64_t unit = span >> 24;
  take(unit * start, unit * (after - start));
  return symbol - max_magnitude;
}

INLINE int32_t decode_residual(const Distributions *distribution, int32_t mean) {
  uint64_t unit = span >> 24;
  int32_t position = (int32_t)target(unit, TOTAL - 1);
  if (position >= TOTAL - ESCAPE) return decode_escape(distribution->max_magnitude);
  const int32_t *bounds = distribution->bounds + (mean + 4) * distribution->stride;
  int32_t bits = distribution->guess_bits;
  int32_t interval = distribution->guesses[(mean + 4) << bits | position >> (24 - bits)];
  int32_t start = bounds[interval], after = bounds[interval + 1];
  while (after <= position) {
    interval++;
    start = after;
    after = bounds[interval + 1];
  }
  if (distribution->shift) return decode_wide(distribution, interval, start, after, mean, position);
  take(unit * start, unit * (after - start));
  return interval - distribution->max_magnitude;
}

// Cells; see `src/codec/gaussians/cells.ts`.

static uint64_t *codes;
static int32_t *cells;
static uint32_t num_elements;

static void read_codes(int32_t bits) {
  struct { uint32_t begin, end; int32_t bit, unsplit_levels; uint64_t prefix; } stack[68], node;
  int32_t top = 0;
  stack[0].begin = 0, stack[0].end = num_elements, stack[0].bit = bits - 1;
  stack[0].unsplit_levels = 0, stack[0].prefix = 0;
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
    int32_t size_class = smaller(bits_of(n) - 1, 8), is_unsplit = bit((size_class - 1) * 4 + node.unsplit_levels);
    uint32_t zeros = is_unsplit ? (raw(1) ? n : 0) : 1 + below(n - 1);
    int32_t unsplit_levels = is_unsplit ? smaller(node.unsplit_levels + 1, 3) : 0;
    top++;
    stack[top].begin = node.begin + zeros, stack[top].end = node.end, stack[top].bit = node.bit - 1;
    stack[top].unsplit_levels = unsplit_levels, stack[top].prefix = node.prefix << 1 | 1;
    top++;
    stack[top].begin = node.begin, stack[top].end = node.begin + zeros, stack[top].bit = node.bit - 1;
    stack[top].unsplit_levels = unsplit_levels, stack[top].prefix = node.prefix << 1;
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

static void read_cells(int32_t cell_bits) {
  int32_t interleaved = (int32_t)raw(1), size = interleaved ? smaller(3 * cell_bits, 8) : 0;
  uint32_t first = (uint32_t)raw(size), num_slots = (uint32_t)raw(size) + 1;
  read_codes(3 * cell_bits - size);
  for (uint32_t i = 0; i < num_elements; i++) {
    uint64_t value = codes[i];
    if (interleaved) {
      uint32_t slot = first + below(num_slots);
      for (int32_t b = size - 1; b >= 0; b--) value = value << 1 | ((slot >> (size - 1 - b)) & 1);
    }
    for (int32_t a = 0; a < 3; a++) cells[a * num_elements + i] = coordinate(value >> a);
  }
}

// Neighbours; see `src/codec/gaussians/neighbours.ts`.

static int32_t indices[NUM_NEIGHBOURS], num_near;
static double weights[NUM_NEIGHBOURS];
static int32_t means[PREDICTED], deviations[PREDICTED];
static double *values;
static int32_t *axes;

// Cells as pairs of 16 bits, x and y in one array, z and 0 in the other, behind `WINDOW` cells that are far away.
static int32_t *narrow_xy, *narrow_z;

static void find_narrow(uint32_t i) {
  int32_t keys[WINDOW];
  const int32_t *xys = narrow_xy + i, *zs = narrow_z + i;
  v128_t xy = wasm_i32x4_splat(xys[WINDOW]), z = wasm_i32x4_splat(zs[WINDOW]);
  v128_t age = wasm_i32x4_const(WINDOW - 1, WINDOW - 2, WINDOW - 3, WINDOW - 4), four = wasm_i32x4_const_splat(4);
  v128_t limit = wasm_i32x4_const_splat(DISTANCE_LIMIT), minima[2];
  minima[0] = minima[1] = wasm_i32x4_const_splat(MAX_KEY);
  for (int32_t k = 0; k < WINDOW; k += 4) {
    v128_t a = wasm_i16x8_sub(xy, wasm_v128_load(xys + k)), c = wasm_i16x8_sub(z, wasm_v128_load(zs + k));
    v128_t d = wasm_i32x4_add(wasm_i32x4_dot_i16x8(a, a), wasm_i32x4_dot_i16x8(c, c));
    v128_t key = wasm_v128_or(wasm_i32x4_shl(wasm_i32x4_min(d, limit), 6), age);
    wasm_v128_store(keys + k, key);
    minima[k >> 2 & 1] = wasm_i32x4_min(minima[k >> 2 & 1], key);
    age = wasm_i32x4_sub(age, four);
  }
  // Two of the least keys of eight groups are at most the larger one of their pair, so that six of them are at most the
  // third smallest, the second largest, of four pairs.
  v128_t pairs = wasm_i32x4_max(minima[0], minima[1]), swapped = wasm_i32x4_shuffle(pairs, pairs, 1, 0, 3, 2);
  v128_t low = wasm_i32x4_min(pairs, swapped), high = wasm_i32x4_max(pairs, swapped);
  int32_t bound = larger(larger(wasm_i32x4_extract_lane(low, 0), wasm_i32x4_extract_lane(low, 2)),
                         smaller(wasm_i32x4_extract_lane(high, 0), wasm_i32x4_extract_lane(high, 2)));
  v128_t bounds = wasm_i32x4_splat(bound);
  int32_t k0 = MAX_KEY, k1 = MAX_KEY, k2 = MAX_KEY, k3 = MAX_KEY, k4 = MAX_KEY, k5 = MAX_KEY;
  uint64_t close = 0;
  for (int32_t k = 0; k < WINDOW; k += 16) {
    v128_t near[4];
    for (int32_t four = 0; four < 4; four++) near[four] = wasm_i32x4_le(wasm_v128_load(keys + k + 4 * four), bounds);
    v128_t half = wasm_i16x8_narrow_i32x4(near[0], near[1]), rest = wasm_i16x8_narrow_i32x4(near[2], near[3]);
    close |= (uint64_t)wasm_i8x16_bitmask(wasm_i8x16_narrow_i16x8(half, rest)) << k;
  }
  for (; close; close &= close - 1) {
    int32_t key = keys[__builtin_ctzll(close)], rest;
#define SORT(smallest) rest = larger(smallest, key), smallest = smaller(smallest, key), key = rest
    SORT(k0);
    SORT(k1);
    SORT(k2);
    SORT(k3);
    SORT(k4);
    k5 = smaller(k5, key);
  }
  indices[0] = k0, indices[1] = k1, indices[2] = k2, indices[3] = k3, indices[4] = k4, indices[5] = k5;
  int32_t num_found = smaller((int32_t)i, NUM_NEIGHBOURS);
  double nearest = ((k0 >> 6) + 1) * 4096.0;
  for (int32_t m = 0; m < num_found; m++) {
    int32_t key = indices[m];
    weights[m] = __builtin_floor(nearest / ((key >> 6) + 1));
    indices[m] = (int32_t)i - 1 - (key & 63);
  }
  num_near = num_found;
}

static void find_wide(uint32_t i) {
  const int32_t *xs = cells, *ys = xs + num_elements, *zs = ys + num_elements;
  int32_t num_found = 0, last = i < WINDOW ? 0 : (int32_t)i - WINDOW;
  for (int32_t j = (int32_t)i - 1; j >= last; j--) {
    double x = xs[i] - xs[j], y = ys[i] - ys[j], z = zs[i] - zs[j], d = x * x + y * y + z * z;
    if (d > 1099511627776.0) d = 1099511627776.0;
    if (num_found == NUM_NEIGHBOURS && d >= weights[NUM_NEIGHBOURS - 1]) continue;
    int32_t at = num_found < NUM_NEIGHBOURS ? num_found++ : NUM_NEIGHBOURS - 1;
    for (; at > 0 && weights[at - 1] > d; at--) {
      weights[at] = weights[at - 1];
      indices[at] = indices[at - 1];
    }
    weights[at] = d;
    indices[at] = j;
  }
  double nearest = (weights[0] + 1) * 4096;
  for (int32_t m = 0; m < num_found; m++) weights[m] = __builtin_floor(nearest / (weights[m] + 1));
  num_near = num_found;
}

// Returns the context of the class.
static int32_t predict(void) {
  if (!num_near) {
    for (int32_t c = 0; c < PREDICTED - 1; c++) means[c] = block_means[c], deviations[c] = 0;
    return 0;
  }
  double total = 0, class_sum;
  v128_t sums[PAIRS] = {0}, floors[PAIRS], deviation_sums[PAIRS] = {0};
  for (int32_t m = 0; m < num_near; m++) {
    const double *row = values + PREDICTED * indices[m];
    v128_t w = wasm_f64x2_splat(weights[m]);
    total += weights[m];
#pragma unroll
    for (int32_t c = 0; c < PAIRS; c++)
      sums[c] = wasm_f64x2_add(sums[c], wasm_f64x2_mul(w, wasm_v128_load(row + 2 * c)));
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
      deviation_sums[c] = wasm_f64x2_add(deviation_sums[c], wasm_f64x2_mul(w, distance));
    }
  }
#pragma unroll
  for (int32_t c = 0; c < PAIRS; c++) {
    wasm_v128_store64_lane(means + 2 * c, wasm_i32x4_trunc_sat_f64x2_zero(floors[c]), 0);
    v128_t quotients = wasm_f64x2_div(deviation_sums[c], totals);
    wasm_v128_store64_lane(deviations + 2 * c, wasm_i32x4_trunc_sat_f64x2_zero(quotients), 0);
  }
  class_sum = wasm_f64x2_extract_lane(sums[PAIRS - 1], 1);
  return 1 + (int32_t)((4 * class_sum + total) / (2 * total));
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

static int32_t absolute, residual_magnitude;

static int32_t exponent(int32_t quantity, int32_t precision_class, int32_t area, int32_t elongation, int32_t flatness,
                        int32_t opacity) {
  const int32_t *c = coefficients + 4 * quantity, constant = constant_terms[8 * quantity + precision_class];
  return (c[0] * area + c[1] * elongation + c[2] * flatness + c[3] * opacity + constant) >> 18;
}

static int32_t deviation_context_of(int32_t num_neighbours, int32_t deviation, int32_t shift) {
  if (num_neighbours < 3) return num_neighbours == 0 ? 0 : 1;
  return 2 + smaller(bits_of((uint32_t)((deviation * 8) >> shift)), NUM_DEVIATION_CONTEXTS - 3);
}

static int32_t decode_value(int32_t kind, int32_t deviation_context, int32_t mean, int32_t shift) {
  int32_t magnitude_context = smaller(bits_of((uint32_t)residual_magnitude), NUM_MAGNITUDE_CONTEXTS - 1);
  if (kind < 2) magnitude_context = shift;
  int32_t context = (kind * NUM_DEVIATION_CONTEXTS + deviation_context) * NUM_MAGNITUDE_CONTEXTS + magnitude_context;
  int32_t mean_steps = 0, mean_fraction = 0;  // whole steps, and eighths of a step
  if (absolute) {
    int32_t eighths = (8 * mean + ((1 << shift) >> 1)) >> shift;
    mean_steps = (eighths + 4) >> 3;
    mean_fraction = eighths - 8 * mean_steps;
  }
  int32_t steps = decode_residual(distributions + scale_indices[context], mean_fraction);
  residual_magnitude = (residual_magnitude + 16 * smaller(steps < 0 ? -steps : steps, 1 << 14)) >> 1;
  // at most 2^24 steps of at most 2^14: more than 32 bits, but all values are clipped to fewer
  int64_t value = ((int64_t)(mean_steps + steps) << shift) + (absolute ? 0 : mean);
  return value > MAX_KEY ? MAX_KEY : value < -MAX_KEY ? -MAX_KEY : (int32_t)value;
}

static void read_axis(int64_t *row, int32_t *stored, int32_t primary, int32_t shift) {
  predict_axis(primary);
  int32_t pole = 0;
  for (int32_t a = 1; a < 3; a++)
    if (magnitude(axis[a]) > magnitude(axis[pole])) pole = a;
  double sign = axis[pole] < 0 ? -1 : 1;
  int32_t first = (pole + 1) % 3, second = (pole + 2) % 3;
  double norm = magnitude(axis[0]) + magnitude(axis[1]) + magnitude(axis[2]);
  double p = sign * axis[first], q = sign * axis[second];
  if (!absolute) {
    double sum = p + q;
    q = p - q;
    p = sum;
  }
  int32_t deviation_context = deviation_context_of(axis_count, axis_deviation, shift);
  int32_t x = clip(decode_value(4, deviation_context, (int32_t)__builtin_floor(p * ONE / norm), shift), -ONE, ONE);
  int32_t limit = absolute ? ONE - (x < 0 ? -x : x) : ONE;
  int32_t y = clip(decode_value(4, deviation_context, (int32_t)__builtin_floor(q * ONE / norm), shift), -limit, limit);
  if (!absolute) {
    int32_t sum = x + y;
    y = (x - y) >> 1;
    x = sum >> 1;
  }
  int32_t decoded[3], rest = ONE - (x < 0 ? -x : x) - (y < 0 ? -y : y);
  decoded[first] = x, decoded[second] = y, decoded[pole] = rest > 0 ? rest : 0;
  if (absolute) {
    int32_t sizes[3], largest = 0;
    for (int32_t a = 0; a < 3; a++) sizes[a] = decoded[a] < 0 ? -decoded[a] : decoded[a];
    for (int32_t a = 1; a < 3; a++)
      if (sizes[a] > sizes[largest]) largest = a;
    if (decoded[largest] < 0)
      for (int32_t a = 0; a < 3; a++) decoded[a] = -decoded[a];
  }
  for (int32_t a = 0; a < 3; a++) row[AXIS + a] = stored[a] = decoded[a];
  row[PRIMARY] = stored[3] = primary;
}

static void read_harmonics(int32_t *decoded, int32_t num_columns, int32_t precision_class, int32_t shift) {
  if (!bit(FIRST_HARMONIC + precision_class)) {
    for (int32_t j = 0; j < num_columns; j++) decoded[j] = 0;
    return;
  }
  int32_t mean_magnitude = 0;
  for (int32_t j = 0; j < num_columns; j++) {
    int32_t group = j < 3 ? 0 : j < 9 ? 1 : j < 21 ? 2 : 3, context = 0, num_steps = 0, is_negative = 0;
    while (context < 7 && mean_magnitude >= magnitude_bounds[context]) context++;
    if (bit(FIRST_HARMONIC + 8 + (context * 4 + group) * 2 + (j % 3 ? 1 : 0))) {
      is_negative = (int32_t)raw(1);
      int32_t base = FIRST_MAGNITUDE + context * 3;
      for (num_steps = 1; num_steps < 15 && bit(base + smaller(num_steps - 1, 2)); num_steps++) continue;
      if (num_steps == 15) {
        uint64_t more = gamma_code();
        num_steps += more > 1 << 20 ? 1 << 20 : (int32_t)more;
      }
    }
    int32_t value = clip(num_steps << shift, 0, MAX_HARMONIC);
    decoded[j] = is_negative ? -value : value;
    mean_magnitude = ((mean_magnitude * 13) >> 4) + smaller(num_steps, 65536) * 16;
  }
}

static void read_gaussian(uint32_t i, int64_t *row, int32_t cell_shift, int32_t box_bits, int32_t lattice_bits,
                          int32_t max_position_shift) {
  double *own_values = values + PREDICTED * i;
  int32_t class_context = predict(), node = 1;
  for (int32_t b = 0; b < 3; b++) node = 2 * node + bit(FIRST_CLASS + 8 * class_context + node);
  int32_t precision_class = node - 8, logs[4] = {0, 0, 0, 0}, flatness = 0, area = 0;
  row[CLASS] = own_values[7] = precision_class;
  residual_magnitude = 16;
  for (int32_t kind = 0; kind < 4; kind++) {
    int32_t s0 = logs[1], elongation = logs[2], low = 0, high = MAX_LOG, max_shift = BITS - 1;
    area = 0;
    if (kind == 0) low = -(10 << BITS), high = -1, max_shift = BITS;
    else if (kind == 1) area = absolute ? 0 : 2 * means[1] - (2 << BITS), low = -MAX_LOG;
    else area = kind == 2 ? 2 * s0 - (2 << BITS) : 2 * s0 - elongation;
    int32_t shift = clip(BITS - exponent(kind, precision_class, area, elongation, 0, logs[0]), 0, max_shift);
    int32_t deviation_context = deviation_context_of(num_near, deviations[kind], shift);
    int32_t value = decode_value(kind, deviation_context, means[kind], shift);
    if (kind == 3) high = absolute ? (MAX_COMPANDED >> shift) << shift : MAX_COMPANDED;
    row[OPACITY + kind] = own_values[kind] = logs[kind] = clip(value, low, high);
  }
  int32_t opacity = logs[0], s0 = logs[1], elongation = logs[2];
  flatness = flatness_table[logs[3]];
  area = 2 * s0 - elongation;
  int32_t position_exponent = exponent(STEP_POSITION, precision_class, area, elongation, flatness, opacity);
  int32_t min_exponent = 1 - ((s0 - elongation) >> BITS);
  if (min_exponent > position_exponent) position_exponent = min_exponent;
  int32_t shift = clip(lattice_bits - position_exponent, 0, absolute ? max_position_shift : box_bits);
  int32_t low_shift = smaller(cell_shift, shift);
  for (int32_t a = 0; a < 3; a++) {
    uint64_t position = (uint64_t)cells[a * num_elements + i] << (cell_shift - low_shift) | raw(cell_shift - low_shift);
    int32_t position_shift = absolute ? shift : low_shift;
    uint64_t step = position >> (position_shift - low_shift);
    row[POSITION + a] = (int64_t)(step << (position_shift + 1) | 1ULL << position_shift);
  }
  int32_t primary = flatness >= elongation ? 2 : 0;
  shift = DIRECTION_BITS - exponent(STEP_DIRECTION, precision_class, area, elongation, flatness, opacity);
  shift = clip(shift, 0, DIRECTION_BITS - 2);
  read_axis(row, axes + 4 * i, primary, shift);
  int32_t bits = clip(exponent(STEP_SPIN, precision_class, area, elongation, flatness, opacity), 0, DIRECTION_BITS);
  row[SPIN_BITS] = bits;
  row[SPIN] = (int64_t)raw(bits);
  shift = clip(BITS - exponent(STEP_COLOUR, precision_class, 0, 0, 0, 0), 0, BITS - 2);
  for (int32_t c = 0; c < 3; c++) {
    int32_t deviation_context = deviation_context_of(num_near, deviations[4 + c], shift);
    int32_t value = decode_value(5 + c, deviation_context, means[4 + c], shift);
    row[LUMA + c] = own_values[4 + c] = clip(value, -MAX_COLOUR, MAX_COLOUR);
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

// `num_harmonics` is the number of harmonics of a colour channel. Most of `coded` are 0. All sums are exact.
static void write_harmonics(float *out, const int32_t *coded, int32_t num_harmonics) {
  v128_t sums[3][MAX_HARMONICS / 2] = {{{0}}};
  int32_t empty = 1;
  for (int32_t k = 0; k < num_harmonics; k++, coded += 3) {
    if (!(coded[0] | coded[1] | coded[2])) continue;
    empty = 0;
    const double *factors = transform + MAX_HARMONICS * k;
    v128_t y = wasm_f64x2_splat(coded[0]), co = wasm_f64x2_splat(coded[1]), cg = wasm_f64x2_splat(coded[2]);
    for (int32_t b = 0; 2 * b < num_harmonics; b++) {
      v128_t factor = wasm_v128_load(factors + 2 * b);
#define ADD(sum, value) sum = wasm_f64x2_add(sum, wasm_f64x2_mul(value, factor))
      ADD(sums[0][b], y);
      ADD(sums[1][b], co);
      ADD(sums[2][b], cg);
    }
  }
  if (empty) {
    for (int32_t n = 0; n < 3 * num_harmonics; n++) out[n] = 0;
    return;
  }
  v128_t unit = wasm_f64x2_const_splat((1 << BITS) * TRANSFORM_UNIT);
  for (int32_t b = 0; 2 * b < num_harmonics; b++, out += 6)
    write_rgb(out, wasm_f64x2_div(sums[0][b], unit), wasm_f64x2_div(sums[1][b], unit), wasm_f64x2_div(sums[2][b], unit),
              2 * b + 1 < num_harmonics);
}

/// Converts the last decoded packet to floating point. Returns the address of its centres, followed by rotations,
/// scales, opacities, colours and harmonics. `half_spacing` is half the lattice spacing, `scene_size` the scene's unit
/// of length.
EXPORT(convert) uint32_t convert(uint32_t num_gaussians, uint32_t num_columns, double half_spacing, double scene_size) {
  reserve(floats_at + 4 * (14 + num_columns) * num_gaussians);
  float *centres = (float *)floats_at, *rotations = centres + 3 * num_gaussians;
  float *standard_deviations = rotations + 4 * num_gaussians, *opacities = standard_deviations + 3 * num_gaussians;
  float *colours = opacities + num_gaussians, *harmonics = colours + 3 * num_gaussians;
  const int64_t *row = decoded_rows;
  for (uint32_t i = 0; i < num_gaussians; i++, row += COLUMNS) {
    for (int32_t a = 0; a < 3; a++) centres[3 * i + a] = (float)((2 * corner[a] + row[POSITION + a]) * half_spacing);
    int32_t s0 = (int32_t)row[SCALE0], s1 = s0 - (int32_t)row[ELONGATION];
    standard_deviations[3 * i] = (float)(scene_size * power_of_two(s0));
    standard_deviations[3 * i + 1] = (float)(scene_size * power_of_two(s1));
    standard_deviations[3 * i + 2] = (float)(scene_size * power_of_two(s1 - flatness_table[(int32_t)row[FLATNESS]]));
    opacities[i] = (float)power_of_two((int32_t)row[OPACITY]);
    const double unit = 1 << BITS;
    write_rgb(colours + 3 * i, wasm_f64x2_splat(row[LUMA] / unit), wasm_f64x2_splat(row[LUMA + 1] / unit),
              wasm_f64x2_splat(row[LUMA + 2] / unit), 0);
    write_rotation(rotations + 4 * i, row);
    if (num_columns)
      write_harmonics(harmonics + num_columns * i, decoded_harmonics + num_columns * i, (int32_t)(num_columns / 3));
  }
  return floats_at;
}

/// Converts the integers of the last packet's `num_gaussians` Gaussians to doubles in place. `convert` comes before.
EXPORT(widen) void widen(uint32_t num_gaussians) {
  for (uint32_t n = 0; n < COLUMNS * num_gaussians; n++) ((double *)decoded_rows)[n] = (double)decoded_rows[n];
}

/// Computes the distributions of the stream's contexts, and `flatness_table`. All tables but `block_means` are filled.
EXPORT(prepare) void prepare(void) {
  for (int32_t log = 0, t = 1; t <= MAX_COMPANDED; log++)
    for (double end = (1 - power_of_two(-log)) * ((1 << BITS) / LN2); t <= end && t <= MAX_COMPANDED;)
      flatness_table[t++] = log;
  for (int32_t bits = 0; bits <= TURN_BITS; bits++)
    for (uint32_t spin = 0; spin < 1u << bits; spin++) set_turn(turns + 2 * ((1u << bits) + spin), bits, spin);
  heap_end = ((uint32_t)&__heap_base + 15) & ~15u;
  for (int32_t scale = 0; scale < NUM_SCALES; scale++) distributions[scale].stride = 0;
  for (int32_t c = 0; c < NUM_RESIDUAL_CONTEXTS; c++) {
    Distributions *distribution = distributions + scale_indices[c];
    if (distribution->stride) continue;
    distribution->scale_index = scale_indices[c], distribution->max_magnitude = max_magnitude_of(scale_indices[c]);
    distribution->shift = 0;
    while ((2 * distribution->max_magnitude >> distribution->shift) >= MAX_STORED_INTERVALS) distribution->shift++;
    distribution->guess_bits = smaller(bits_of((uint32_t)distribution->max_magnitude) + 1, MAX_GUESS_BITS);
    distribution->stride = (2 * distribution->max_magnitude >> distribution->shift) + 2;
    uint32_t num_guesses = NUM_MEANS << distribution->guess_bits;
    reserve(heap_end + 2 * num_guesses + 4 * NUM_MEANS * distribution->stride);
    uint16_t *guess = (uint16_t *)heap_end;
    int32_t *bound = (int32_t *)(heap_end + 2 * num_guesses);
    distribution->guesses = guess, distribution->bounds = bound;
    for (int32_t mean = -4; mean < 4; mean++, guess += 1 << distribution->guess_bits, bound += distribution->stride)
      tabulate(distribution, mean, guess, bound);
    heap_end += 2 * num_guesses + 4 * NUM_MEANS * distribution->stride;
  }
}

/// Returns the address for a payload of `bytes` bytes.
EXPORT(begin) uint32_t begin(uint32_t bytes) {
  if (!heap_end) heap_end = ((uint32_t)&__heap_base + 15) & ~15u;
  reserve(heap_end + bytes);
  return heap_end;
}

/// Counts the elements of each of `num_lanes` lanes among `size` elements from `first` on; see `src/packets/plan.ts`.
/// Returns the address of the counts, int32.
EXPORT(lanes) uint32_t lanes(uint32_t first, uint32_t size, uint32_t low, uint32_t high, uint32_t num_lanes) {
  int32_t *counts = (int32_t *)begin(4 * num_lanes);
  for (uint32_t n = 0; n < num_lanes; n++) counts[n] = 0;
  for (uint32_t end = first + size; first < end; first++) {
    uint64_t z = ((uint64_t)high << 32 | (first ^ low)) + 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    counts[(z ^ z >> 31) % num_lanes]++;
  }
  return heap_end;
}

/// Updates the state of SHA-256 (FIPS 180-4) with `blocks` blocks of 64 bytes. At `begin` lie the 8 words of the state,
/// the 64 constants of the rounds, and the blocks. Four blocks at a time are expanded, one in each lane, because only
/// the rounds depend on the blocks before; up to three blocks behind the last one are read.
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
      v128_t sum_x = ROTATED_LANES(x, 7) ^ ROTATED_LANES(x, 18) ^ wasm_u32x4_shr(x, 3);
      v128_t sum_y = ROTATED_LANES(y, 17) ^ ROTATED_LANES(y, 19) ^ wasm_u32x4_shr(y, 10);
      words[t] = words[t - 16] + sum_x + words[t - 7] + sum_y;
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

/// Decodes a packet of `num_gaussians` Gaussians with `num_columns` integers of harmonics each from the payload at
/// `begin`. Returns the address of `COLUMNS` 64-bit integers for each Gaussian. The integers of harmonics follow them.
EXPORT(decode) uint32_t decode(
    uint32_t bytes, uint32_t num_gaussians, uint32_t num_columns, int32_t box_bits, int32_t lattice_bits,
    int32_t max_position_shift) {
  uint32_t rows_at = (heap_end + bytes + 15) & ~15u, harmonics_at = rows_at + 8 * COLUMNS * num_gaussians;
  uint32_t values_at = (harmonics_at + 4 * num_columns * num_gaussians + 15) & ~15u;
  uint32_t axes_at = values_at + 8 * PREDICTED * num_gaussians, codes_at = axes_at + 16 * num_gaussians;
  uint32_t cells_at = codes_at + 8 * num_gaussians;
  reserve(cells_at + 20 * num_gaussians + 12 * WINDOW + PADDING_BYTES + bytes);
  narrow_xy = (int32_t *)(cells_at + 12 * num_gaussians + 4 * WINDOW);
  narrow_z = narrow_xy + num_gaussians + WINDOW;
  decoded_rows = (int64_t *)rows_at;
  decoded_harmonics = (int32_t *)harmonics_at;
  floats_at = values_at;  // what lies there is not needed after the packet is decoded
  values = (double *)values_at;
  axes = (int32_t *)axes_at;
  codes = (uint64_t *)codes_at;
  cells = (int32_t *)cells_at;
  num_elements = num_gaussians;
  absolute = max_position_shift >= 0;
  for (int32_t i = 0; i < 2 * NUM_CONTEXTS; i++) models[i] = initial_models[i];
  start_decoder(bytes, (uint8_t *)(narrow_z + num_gaussians + WINDOW));
  int32_t min_shift = box_bits - 21, cell_shift = clip((int32_t)raw(6), min_shift > 0 ? min_shift : 0, box_bits);
  read_cells(box_bits - cell_shift);
  if (box_bits - cell_shift <= NARROW_BITS) {
    for (uint32_t i = 0; i < WINDOW; i++) narrow_xy[i] = PADDING_CELL, narrow_z[i] = 0;
    for (uint32_t i = 0; i < num_gaussians; i++) {
      narrow_xy[WINDOW + i] = cells[i] | cells[num_gaussians + i] << 16;
      narrow_z[WINDOW + i] = cells[2 * num_gaussians + i];
    }
  }
  for (uint32_t i = 0; i < num_gaussians; i++) {
    if (box_bits - cell_shift <= NARROW_BITS) find_narrow(i);
    else find_wide(i);
    read_gaussian(i, decoded_rows + COLUMNS * i, cell_shift, box_bits, lattice_bits, max_position_shift);
    if (num_columns) {
      int32_t precision_class = (int32_t)values[PREDICTED * i + 7];
      int32_t shift = clip(BITS - exponent(STEP_HARMONICS, precision_class, 0, 0, 0, 0), 0, BITS - 2);
      read_harmonics((int32_t *)harmonics_at + num_columns * i, (int32_t)num_columns, precision_class, shift);
    }
  }
  return rows_at;
}

// Motion; see `src/codec/tracks/motion.ts`, `predict.ts` and `trajectories.ts`.

#define CHANNELS 13
#define KINDS 5
#define HEADER_FIELDS 6
#define MOVING 1
#define MAX_FRAMES 64
#define MAX_TRACK_SPAN 4096
#define NEIGHBOUR_CONTEXTS 10
#define DEGREE_CONTEXTS 8
#define OCTAVE_CONTEXTS 16
#define MAX_OCTAVE 29
#define MAX_LEAD (1 << 24)
#define NUM_NEAREST 8
#define WEIGHT 4096
#define FAR_AWAY 0x1p60f  // above all squared distances
#define MAX_COEFFICIENT 0x1p36

enum { TRACK, STATE, BEGINS, ENDS, GAP_BEFORE, GAP_AFTER };
enum { C_GONE = 0, C_MOVING = 2, C_ENDS = 6, C_BEGINS = 7, C_ZERO = 8, C_OCTAVE = 408 };

// Tables that the caller fills: units of the channels, polynomials with one row of `MAX_FRAMES` values per degree, and
// the models of a packet's start.
struct {
  double units[CHANNELS + 1], polynomials[MAX_FRAMES * MAX_FRAMES];
  int32_t models[2 * MOTION_CONTEXTS];
} motion;

static const uint8_t kind_of[CHANNELS] = {0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4};
static int32_t num_coefficients[KINDS], row_size, row_stride, *headers, *residuals, num_frames;

static int32_t read_headers(int32_t first_new) {
  int32_t first = (int32_t)raw(28);
  uint64_t gap = gamma_code();
  int32_t previous_end = first - (gap > MAX_LEAD ? MAX_LEAD : (int32_t)gap);
  int32_t end = first + smaller((int32_t)raw(13), MAX_TRACK_SPAN);
  gap = gamma_code();
  int32_t num_read = 0, is_gone = 0, moving_history = 0;
  for (int32_t track = first; track < end; track++) {
    is_gone = bit(C_GONE + is_gone);
    if (is_gone) continue;
    if (num_read == (int32_t)num_elements) break;
    int32_t state = bit(C_MOVING + moving_history), *row = headers + HEADER_FIELDS * num_read++;
    moving_history = (moving_history << 1 | state) & 3;
    row[TRACK] = track;
    row[STATE] = state;
    row[BEGINS] = track >= first_new && bit(C_BEGINS) ? (int32_t)below(num_frames) : 0;
    row[ENDS] = bit(C_ENDS) ? (int32_t)below(num_frames) : num_frames;
    row[GAP_BEFORE] = track - previous_end;
    row[GAP_AFTER] = 0;
    previous_end = track + 1;
  }
  if (num_read) headers[HEADER_FIELDS * (num_read - 1) + GAP_AFTER] = gap > MAX_LEAD ? MAX_LEAD : (int32_t)gap;
  return num_read;
}

static int32_t read_coefficient(int32_t kind, int32_t degree, int32_t neighbour_context) {
  int32_t degree_context = kind * DEGREE_CONTEXTS + smaller(degree, DEGREE_CONTEXTS - 1);
  if (!bit(C_ZERO + degree_context * NEIGHBOUR_CONTEXTS + neighbour_context)) return 0;
  int32_t base = C_OCTAVE + (kind * NEIGHBOUR_CONTEXTS + neighbour_context) * OCTAVE_CONTEXTS, octave = 0;
  while (octave < MAX_OCTAVE && bit(base + smaller(octave, OCTAVE_CONTEXTS - 1))) octave++;
  uint32_t value = (1u << octave) + (uint32_t)raw(octave);
  if (value > 0x3fffffff) value = 0x3fffffff;
  return raw(1) ? -(int32_t)value : (int32_t)value;
}

static void read_track(int32_t *row, const int32_t *previous_row) {
  int32_t largest_of_kind = 0;
  for (int32_t c = 0, at = 0; c < CHANNELS; c++) {
    int32_t kind = kind_of[c], is_first_of_kind = !c || kind_of[c - 1] != kind, largest_of_channel = 0;
    if (is_first_of_kind) {
      largest_of_kind = 0;
      if (previous_row && num_coefficients[kind]) largest_of_channel = __builtin_abs(previous_row[at]);
    }
    for (int32_t k = 0; k < num_coefficients[kind]; k++, at++) {
      uint32_t expected_magnitude = larger(largest_of_channel, largest_of_kind);
      uint32_t same_degree = is_first_of_kind ? 0 : 2 * (uint32_t)__builtin_abs(row[at - num_coefficients[kind]]);
      if (same_degree > expected_magnitude) expected_magnitude = same_degree;
      int32_t value = row[at] = read_coefficient(kind, k, smaller(bits_of(expected_magnitude), NEIGHBOUR_CONTEXTS - 1));
      int32_t is_first = k == 0 && is_first_of_kind;
      largest_of_channel = is_first ? __builtin_abs(value) : larger(largest_of_channel, __builtin_abs(value));
    }
    largest_of_kind = larger(largest_of_kind, largest_of_channel);
  }
}

/// Decodes the headers and residuals of a packet of `num_tracks` tracks over `frames` frames from the payload at
/// `begin`. Returns the address of the headers. Behind them lies room for shifts, int32 (num_tracks, 13), for positions,
/// double (num_tracks, 3), at a multiple of 8, and for an order, int32 (num_tracks).
EXPORT(readMotion) uint32_t read_motion(uint32_t bytes, uint32_t num_tracks, int32_t frames, int32_t first_new) {
  uint32_t headers_at = (heap_end + bytes + 15) & ~15u;
  uint32_t positions_at = (headers_at + 4 * (HEADER_FIELDS + CHANNELS) * num_tracks + 7) & ~7u;
  uint32_t reversed_at = positions_at + 28 * num_tracks, residuals_at = (reversed_at + PADDING_BYTES + bytes + 7) & ~7u;
  reserve(residuals_at);
  headers = (int32_t *)headers_at;
  residuals = (int32_t *)residuals_at;
  num_elements = num_tracks;
  num_frames = frames;
  for (int32_t i = 0; i < 2 * MOTION_CONTEXTS; i++) models[i] = motion.models[i];
  for (uint32_t i = 0; i < HEADER_FIELDS * num_tracks; i++) headers[i] = -1;
  start_decoder(bytes, (uint8_t *)reversed_at);
  int32_t num_read = read_headers(first_new);
  for (int32_t kind = 0; kind < KINDS; kind++) num_coefficients[kind] = (int32_t)below(frames + 1);
  row_size = num_coefficients[0] + num_coefficients[1] + num_coefficients[2] + num_coefficients[4];
  row_size = 3 * row_size + num_coefficients[3];
  row_stride = (row_size + 1) & ~1;
  reserve(residuals_at + 4 * row_size * num_tracks);
  int32_t *previous_row = 0;
  for (int32_t i = 0; i < num_read; i++) {
    if (headers[HEADER_FIELDS * i + STATE] != MOVING) continue;
    read_track(residuals + i * row_size, previous_row);
    previous_row = residuals + i * row_size;
  }
  return headers_at;
}

static double *positions, *rows_of;
static float *known;  // coordinates of the known tracks in their sequence, one axis after another
static int32_t *known_tracks;  // their rows in the packet
static uint32_t num_known, padded_tracks;

static void add_known(uint32_t i) {
  for (int32_t a = 0; a < 3; a++) known[a * padded_tracks + num_known] = (float)positions[3 * i + a];
  known_tracks[num_known++] = (int32_t)i;
}

// Positions of the nearest tracks in the sequence of known tracks, nearest first, and their squared distances.
static uint32_t nearest[NUM_NEAREST];
static double squared_distances[NUM_NEAREST];
static float *rounded_squares;  // rounded squared distances of the known tracks

static int32_t find_known(uint32_t i) {
  const double *own_position = positions + 3 * i;
  v128_t xyz[3], minima[2], bound;
  for (int32_t a = 0; a < 3; a++) xyz[a] = wasm_f32x4_splat((float)own_position[a]);
  minima[0] = minima[1] = wasm_f32x4_const_splat(FAR_AWAY * FAR_AWAY * 4);
  for (uint32_t n = 0; n < num_known; n += 4) {
    const float *at = known + n;
    v128_t x = wasm_f32x4_sub(wasm_v128_load(at), xyz[0]);
    v128_t y = wasm_f32x4_sub(wasm_v128_load(at + padded_tracks), xyz[1]);
    v128_t z = wasm_f32x4_sub(wasm_v128_load(at + 2 * padded_tracks), xyz[2]);
    v128_t d = wasm_f32x4_add(wasm_f32x4_add(wasm_f32x4_mul(x, x), wasm_f32x4_mul(y, y)), wasm_f32x4_mul(z, z));
    wasm_v128_store(rounded_squares + n, d);  // differences are exact, squares are rounded
    bound = wasm_f32x4_pmin(minima[0], d);
    minima[1] = wasm_f32x4_pmin(minima[1], wasm_f32x4_pmax(minima[0], d));
    minima[0] = bound;
  }
  // The second least of each lane: eight tracks are at most as far as the farthest of these.
  bound = wasm_f32x4_pmax(minima[1], wasm_i32x4_shuffle(minima[1], minima[1], 1, 0, 3, 2));
  bound = wasm_f32x4_pmax(bound, wasm_i32x4_shuffle(bound, bound, 2, 3, 0, 1));
  bound = wasm_f32x4_mul(bound, wasm_f32x4_const_splat(1.000001f));
  int32_t num_found = 0;
  for (uint32_t n = 0; n < num_known; n += 4) {
    uint32_t is_near = wasm_i32x4_bitmask(wasm_f32x4_le(wasm_v128_load(rounded_squares + n), bound));
    for (; is_near; is_near &= is_near - 1) {
      uint32_t position = n + (uint32_t)__builtin_ctz(is_near);
      if (position >= num_known) break;
      double squared_distance = 0;
      for (int32_t a = 0; a < 3; a++) {
        double difference = known[a * padded_tracks + position] - own_position[a];
        squared_distance += difference * difference;
      }
      int32_t m = num_found;
      if (num_found < NUM_NEAREST) num_found++;
      else if (squared_distance >= squared_distances[--m]) continue;
      for (; m > 0 && squared_distances[m - 1] > squared_distance; m--)
        squared_distances[m] = squared_distances[m - 1], nearest[m] = nearest[m - 1];
      squared_distances[m] = squared_distance, nearest[m] = position;
    }
  }
  return num_found;
}

// Weights of the nearest tracks in the plane fit.
static double plane_weights[NUM_NEAREST];

static void fit_plane(uint32_t i, int32_t num_found) {
  double o[3 * NUM_NEAREST], proximities[NUM_NEAREST], radius = 1, total = 0, sums[3] = {0}, m[6] = {0};
  for (int32_t n = 0; n < num_found; n++) {
    for (int32_t a = 0; a < 3; a++) {
      o[3 * n + a] = positions[3 * known_tracks[nearest[n]] + a] - positions[3 * i + a];
      if (magnitude(o[3 * n + a]) > radius) radius = magnitude(o[3 * n + a]);
    }
  }
  for (int32_t n = 0; n < num_found; n++) {
    double w = proximities[n] = 1 + __builtin_floor(2 * (squared_distances[0] + 1) / (squared_distances[n] + 1));
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
  double trace = m[0] + m[3] + m[5], divisor = 1, factor = 1, largest = 0, h[3];
  while (__builtin_floor(trace / divisor) >= 65536) divisor *= 2;
  double ridge = __builtin_floor(trace / (divisor * 16384)) + 4;
  for (int32_t n = 0; n < 6; n++) m[n] = __builtin_floor(m[n] / divisor) + (n == 0 || n == 3 || n == 5 ? ridge : 0);
  double a = m[3] * m[5] - m[4] * m[4], b = m[2] * m[4] - m[1] * m[5], c = m[1] * m[4] - m[2] * m[3];
  double d = m[0] * m[5] - m[2] * m[2], e = m[1] * m[2] - m[0] * m[4], g = m[0] * m[3] - m[1] * m[1];
  double determinant = m[0] * a + m[1] * b + m[2] * c;
  if (determinant < 1) determinant = 1;
  h[0] = a * sums[0] + b * sums[1] + c * sums[2];
  h[1] = b * sums[0] + d * sums[1] + e * sums[2];
  h[2] = c * sums[0] + e * sums[1] + g * sums[2];
  for (int32_t n = 0; n < 3; n++) largest = magnitude(h[n]) > largest ? magnitude(h[n]) : largest;
  while (__builtin_floor(largest / factor) >= 0x1p33) factor *= 2;
  for (int32_t n = 0; n < 3; n++) h[n] = __builtin_floor(h[n] / factor);
  double scale = 0x1p20 * factor / divisor;
  for (int32_t n = 0; n < num_found; n++) {
    double moment = h[0] * (total * o[3 * n] - sums[0]) + h[1] * (total * o[3 * n + 1] - sums[1]) +
                    h[2] * (total * o[3 * n + 2] - sums[2]);
    double turn = __builtin_floor(moment / determinant * scale + 0.5);
    double weight = __builtin_floor(proximities[n] * (0x1p20 - turn) / (total * (0x1p20 / WEIGHT)));
    plane_weights[n] = weight < -WEIGHT ? -WEIGHT : weight > WEIGHT ? WEIGHT : weight;
  }
}

static void predict_track(uint32_t i, const int32_t *shifts) {
  int32_t num_found = find_known(i);
  double remaining_weight = WEIGHT, *own_row = rows_of + i * row_stride;
  for (int32_t m = 0; m < num_found; m++) plane_weights[m] = __builtin_floor((double)WEIGHT / num_found);
  if (num_found >= 4) fit_plane(i, num_found);
  for (int32_t m = 0; m < num_found; m++) remaining_weight -= plane_weights[m];
  if (num_found) plane_weights[0] += remaining_weight;
  int32_t num_moving = 0;
  const double *rows[NUM_NEAREST];
  v128_t weights_of[NUM_NEAREST];
  for (int32_t m = 0; m < num_found; m++) {
    int32_t j = known_tracks[nearest[m]];
    if (headers[HEADER_FIELDS * j + STATE] != MOVING) continue;
    rows[num_moving] = rows_of + j * row_stride;
    weights_of[num_moving++] = wasm_f64x2_splat(plane_weights[m]);
  }
  for (int32_t u = 0; u < row_stride; u += 2) {
    v128_t sum = wasm_f64x2_splat(0);
    for (int32_t m = 0; m < num_moving; m++)
      sum = wasm_f64x2_add(sum, wasm_f64x2_mul(weights_of[m], wasm_v128_load(rows[m] + u)));
    wasm_v128_store(own_row + u, sum);
  }
  for (int32_t c = 0, u = 0; c < CHANNELS; c++) {
    double step = 1u << shifts[CHANNELS * i + c];
    for (int32_t k = 0; k < num_coefficients[kind_of[c]]; k++, u++) {
      double value = __builtin_floor((own_row[u] + WEIGHT / 2) / WEIGHT) + residuals[i * row_size + u] * step;
      own_row[u] = value < -MAX_COEFFICIENT ? -MAX_COEFFICIENT : value > MAX_COEFFICIENT ? MAX_COEFFICIENT : value;
    }
  }
}

// Writes the offsets of a track. Its frames are `frame_stride` numbers apart.
static void write_offsets(const double *coefficients, float *out, uint32_t frame_stride) {
  int32_t has_colour = 0;
  for (int32_t c = 0; c < CHANNELS; coefficients += num_coefficients[kind_of[c++]]) {
    int32_t end = num_coefficients[kind_of[c]];
    while (end && coefficients[end - 1] == 0) end--;
    if (!end) continue;
    has_colour |= kind_of[c] == KINDS - 1;
    for (int32_t f = 0; f < num_frames; f += 2) {
      v128_t sum = wasm_f64x2_splat(0);
      for (int32_t k = 0; k < end; k++) {
        v128_t values = wasm_v128_load(motion.polynomials + MAX_FRAMES * k + f);
        sum = wasm_f64x2_add(sum, wasm_f64x2_mul(wasm_f64x2_splat(coefficients[k]), values));
      }
      sum = wasm_f32x4_demote_f64x2_zero(wasm_f64x2_mul(sum, wasm_f64x2_splat(motion.units[c])));
      out[frame_stride * f + c] = wasm_f32x4_extract_lane(sum, 0);
      if (f + 1 < num_frames) out[frame_stride * (f + 1) + c] = wasm_f32x4_extract_lane(sum, 1);
    }
  }
  if (!has_colour) return;
  for (int32_t f = 0; f < num_frames; f++, out += frame_stride) {
    double y = out[10] / R3, co = out[11], cg = out[12];
    out[10] = (float)(y + co / R2 - cg / R6);
    out[11] = (float)(y + 2 * cg / R6);
    out[12] = (float)(y - co / R2 - cg / R6);
  }
}

/// Computes the offsets of the packet's tracks, float (frames, number, 13), from the shifts and positions behind its
/// headers, and the order in which `num_moving` tracks are predicted behind them, int32. Returns their address.
EXPORT(offsets) uint32_t offsets(uint32_t num_moving) {
  const int32_t *shifts = headers + HEADER_FIELDS * num_elements;
  positions = (double *)(((uint32_t)(shifts + CHANNELS * num_elements) + 7) & ~7u);
  const int32_t *order = (int32_t *)(positions + 3 * num_elements);
  uint32_t rows_at = ((uint32_t)(residuals + row_size * num_elements) + 15) & ~15u;
  uint32_t known_at = (rows_at + 8 * row_stride * num_elements + 15) & ~15u;
  padded_tracks = (num_elements + 3) & ~3u;
  uint32_t out_at = known_at + 16 * padded_tracks + 4 * num_elements, frame_stride = CHANNELS * num_elements;
  reserve(out_at + 4 * frame_stride * num_frames);
  rows_of = (double *)rows_at, known = (float *)known_at, rounded_squares = known + 3 * padded_tracks;
  known_tracks = (int32_t *)(rounded_squares + padded_tracks);
  for (uint32_t n = 0; n < 3 * padded_tracks; n++) known[n] = FAR_AWAY;
  num_known = 0;
  for (uint32_t i = 0; i < num_elements; i++)
    if (headers[HEADER_FIELDS * i + STATE] != MOVING) add_known(i);
  for (uint32_t n = 0; n < num_moving; n++) {
    predict_track((uint32_t)order[n], shifts);
    add_known((uint32_t)order[n]);
  }
  __builtin_memset((float *)out_at, 0, 4 * frame_stride * num_frames);
  for (uint32_t i = 0; i < num_elements; i++)
    if (headers[HEADER_FIELDS * i + STATE] == MOVING)
      write_offsets(rows_of + i * row_stride, (float *)out_at + CHANNELS * i, frame_stride);
  return out_at;
}
