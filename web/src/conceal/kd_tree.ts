// Nearest neighbours among points in space.

const LEAF = 12;

/** A balanced k-d tree over points, x y z of each. */
export class KdTree {
  readonly #order: Int32Array;
  readonly #far: Float64Array;
  readonly #who: Int32Array;
  #count = 0;
  #self = -1;

  /** Of points that are equally far, those of the smaller key are nearer; their order where there are no keys. */
  constructor(
    readonly points: Float32Array,
    readonly k: number,
    readonly keys: Int32Array | null = null,
  ) {
    this.#order = Int32Array.from({ length: points.length / 3 }, (_, i) => i);
    this.#far = new Float64Array(k);
    this.#who = new Int32Array(k);
    this.#build(0, this.#order.length, 0);
  }

  /** The nearest k others of a point, in no order; valid until the next call. */
  nearestOthers(i: number): Int32Array {
    return this.nearest(this.points[3 * i], this.points[3 * i + 1], this.points[3 * i + 2], i);
  }

  /** The same of any place, and of a point that does not count. */
  nearest(x: number, y: number, z: number, self = -1): Int32Array {
    this.#count = 0;
    this.#self = self;
    this.#search(0, this.#order.length, 0, x, y, z);
    return this.#who.subarray(0, this.#count);
  }

  /** The same as `nearestOthers`, nearest first. */
  nearestFirst(i: number): Int32Array {
    const near = this.nearestOthers(i),
      far = this.#far;
    for (let n = 1; n < near.length; n++) {
      const who = near[n],
        d = far[n];
      let at = n;
      for (; at > 0 && this.#isNearer(d, who, far[at - 1], near[at - 1]); at--) {
        far[at] = far[at - 1];
        near[at] = near[at - 1];
      }
      far[at] = d;
      near[at] = who;
    }
    return near;
  }

  /** Squares of the distances of what was found last, in its order. */
  get distances(): Float64Array {
    return this.#far;
  }

  #isNearer(d: number, i: number, other: number, j: number): boolean {
    return d < other || (d === other && (this.keys ? this.keys[i] < this.keys[j] : i < j));
  }

  #build(begin: number, end: number, depth: number): void {
    if (end - begin <= LEAF) return;
    const middle = (begin + end) >> 1,
      axis = depth % 3;
    this.#select(begin, end - 1, middle, axis);
    this.#build(begin, middle, depth + 1);
    this.#build(middle + 1, end, depth + 1);
  }

  /** Puts what belongs at `middle` there, smaller before it and larger behind (Hoare's selection). */
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

  #search(begin: number, end: number, depth: number, x: number, y: number, z: number): void {
    if (end - begin <= LEAF) {
      for (let n = begin; n < end; n++) this.#offer(this.#order[n], x, y, z);
      return;
    }
    const middle = (begin + end) >> 1,
      axis = depth % 3,
      i = this.#order[middle];
    const away = (axis === 0 ? x : axis === 1 ? y : z) - this.points[3 * i + axis];
    this.#offer(i, x, y, z);
    if (away < 0) this.#search(begin, middle, depth + 1, x, y, z);
    else this.#search(middle + 1, end, depth + 1, x, y, z);
    if (this.#count === this.k && away * away > this.#far[0]) return;
    if (away < 0) this.#search(middle + 1, end, depth + 1, x, y, z);
    else this.#search(begin, middle, depth + 1, x, y, z);
  }

  /** Keeps the k nearest in a heap, the farthest at its top. */
  #offer(i: number, x: number, y: number, z: number): void {
    if (i === this.#self) return;
    const far = this.#far,
      who = this.#who,
      points = this.points;
    const dx = points[3 * i] - x,
      dy = points[3 * i + 1] - y,
      dz = points[3 * i + 2] - z,
      d = dx * dx + dy * dy + dz * dz;
    let at: number;
    if (this.#count < this.k) {
      for (at = this.#count++; at > 0; at = (at - 1) >> 1) {
        const parent = (at - 1) >> 1;
        if (!this.#isNearer(far[parent], who[parent], d, i)) break;
        far[at] = far[parent];
        who[at] = who[parent];
      }
    } else {
      if (!this.#isNearer(d, i, far[0], who[0])) return;
      for (at = 0; ; ) {
        let child = 2 * at + 1;
        if (child >= this.k) break;
        if (child + 1 < this.k && this.#isNearer(far[child], who[child], far[child + 1], who[child + 1])) child++;
        if (!this.#isNearer(d, i, far[child], who[child])) break;
        far[at] = far[child];
        who[at] = who[child];
        at = child;
      }
    }
    far[at] = d;
    who[at] = i;
  }
}
