// Nearest neighbours in three dimensions.

const LEAF_SIZE = 12;

/** Balanced k-d tree over points, shape (count, 3). */
export class KdTree {
  readonly #order: Int32Array;
  /** Points in tree order, so that nearby points are adjacent in memory. */
  readonly #sorted: Float32Array;
  readonly #squaredDistances: Float64Array;
  readonly #indices: Int32Array;
  readonly #query = new Float64Array(3);
  #count = 0;
  #excluded = -1;
  /** Points that are left out of searches (1); null if none. */
  leftOut: Uint8Array | null = null;

  /**
   * Builds a tree for the `k` nearest neighbours. Among equally distant points, the smaller key is nearer. The default
   * key is the index. Building is faster with a `similar` tree of the same points at slightly different positions.
   */
  constructor(
    readonly points: Float32Array,
    readonly k: number,
    readonly keys: Int32Array | null = null,
    similar: KdTree | null = null,
  ) {
    this.#order = similar ? similar.#order.slice() : Int32Array.from({ length: points.length / 3 }, (_, i) => i);
    this.#squaredDistances = new Float64Array(k);
    this.#indices = new Int32Array(k);
    this.#build(0, this.#order.length, 0);
    this.#sorted = new Float32Array(points.length);
    for (let n = 0; n < this.#order.length; n++)
      for (let a = 0; a < 3; a++) this.#sorted[3 * n + a] = points[3 * this.#order[n] + a];
  }

  /**
   * Returns the indices of the `k` nearest other points, in no particular order. The array is reused by the next call.
   */
  nearestOthers(i: number): Int32Array {
    return this.nearest(this.points[3 * i], this.points[3 * i + 1], this.points[3 * i + 2], i);
  }

  /** Returns the indices of the `k` points nearest to a position, without the point `self`. */
  nearest(x: number, y: number, z: number, self = -1): Int32Array {
    this.#count = 0;
    this.#excluded = self;
    this.#query.set([x, y, z]);
    this.#search(0, this.#order.length, 0, 0, 0, 0);
    return this.#indices.subarray(0, this.#count);
  }

  /** Returns the same as `nearestOthers`, nearest first. */
  nearestFirst(i: number): Int32Array {
    const near = this.nearestOthers(i),
      far = this.#squaredDistances;
    for (let n = 1; n < near.length; n++) {
      const indices = near[n],
        d = far[n];
      let at = n;
      for (; at > 0 && this.#isNearer(d, indices, far[at - 1], near[at - 1]); at--) {
        far[at] = far[at - 1];
        near[at] = near[at - 1];
      }
      far[at] = d;
      near[at] = indices;
    }
    return near;
  }

  /** Squared distances of the last result, in its order. */
  get distances(): Float64Array {
    return this.#squaredDistances;
  }

  #isNearer(d: number, i: number, other: number, j: number): boolean {
    return d < other || (d === other && (this.keys ? this.keys[i] < this.keys[j] : i < j));
  }

  #build(begin: number, end: number, depth: number): void {
    if (end - begin <= LEAF_SIZE) return;
    const middle = (begin + end) >> 1,
      axis = depth % 3;
    this.#select(begin, end - 1, middle, axis);
    this.#build(begin, middle, depth + 1);
    this.#build(middle + 1, end, depth + 1);
  }

  /** Partitions the range around its element of rank `middle` (Hoare's quickselect). */
  #select(low: number, high: number, middle: number, axis: number): void {
    const order = this.#order,
      points = this.points;
    while (low < high) {
      const pivot = points[3 * order[(low + high) >> 1] + axis];
      let i = low,
        j = high;
      while (i <= j) {
        while (points[3 * order[i] + axis] < pivot) i++;
        while (points[3 * order[j] + axis] > pivot) j--;
        if (i <= j) [order[i++], order[j--]] = [order[j], order[i]];
      }
      if (middle <= j) high = j;
      else if (middle >= i) low = i;
      else return;
    }
  }

  /** Searches a subtree. `dx`, `dy` and `dz` are the distances to its region along the axes. */
  #search(begin: number, end: number, axis: number, dx: number, dy: number, dz: number): void {
    if (end - begin <= LEAF_SIZE) {
      this.#visitLeaf(begin, end);
      return;
    }
    const middle = (begin + end) >> 1,
      next = axis === 2 ? 0 : axis + 1,
      away = this.#query[axis] - this.#sorted[3 * middle + axis];
    if (away < 0) this.#search(begin, middle, next, dx, dy, dz);
    else this.#search(middle + 1, end, next, dx, dy, dz);
    this.#visitLeaf(middle, middle + 1);
    if (axis === 0) dx = away;
    else if (axis === 1) dy = away;
    else dz = away;
    if (this.#count === this.k && dx * dx + dy * dy + dz * dz > this.#squaredDistances[0]) return;
    if (away < 0) this.#search(middle + 1, end, next, dx, dy, dz);
    else this.#search(begin, middle, next, dx, dy, dz);
  }

  /** Adds the near points of a leaf to the result. */
  #visitLeaf(begin: number, end: number): void {
    const x = this.#query[0],
      y = this.#query[1],
      z = this.#query[2],
      sorted = this.#sorted,
      order = this.#order,
      far = this.#squaredDistances;
    for (let n = begin, at = 3 * begin; n < end; n++, at += 3) {
      const dx = sorted[at] - x,
        dy = sorted[at + 1] - y,
        dz = sorted[at + 2] - z,
        d = dx * dx + dy * dy + dz * dz;
      if (this.#count < this.k) this.#add(d, order[n]);
      else if (d <= far[0]) this.#replace(d, order[n]);
    }
  }

  /** Adds a point to the heap. Its top is the farthest point. */
  #add(d: number, i: number): void {
    if (i === this.#excluded || this.leftOut?.[i]) return;
    const far = this.#squaredDistances,
      indices = this.#indices;
    let at = this.#count++;
    while (at > 0) {
      const parent = (at - 1) >> 1;
      if (!this.#isNearer(far[parent], indices[parent], d, i)) break;
      far[at] = far[parent];
      indices[at] = indices[parent];
      at = parent;
    }
    far[at] = d;
    indices[at] = i;
  }

  /** Replaces the farthest point of the heap if the new one is nearer. */
  #replace(d: number, i: number): void {
    const far = this.#squaredDistances,
      indices = this.#indices;
    if (i === this.#excluded || this.leftOut?.[i] || !this.#isNearer(d, i, far[0], indices[0])) return;
    let at = 0;
    for (let child = 1; child < this.k; child = 2 * at + 1) {
      if (child + 1 < this.k && this.#isNearer(far[child], indices[child], far[child + 1], indices[child + 1])) child++;
      if (!this.#isNearer(d, i, far[child], indices[child])) break;
      far[at] = far[child];
      indices[at] = indices[child];
      at = child;
    }
    far[at] = d;
    indices[at] = i;
  }
}
