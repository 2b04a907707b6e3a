// Nearest neighbours among points in space.

const LEAF = 12;

/** A balanced k-d tree over points, x y z of each. */
export class KdTree {
  readonly #order: Int32Array;
  /** Points in that order: those that are near each other are read together. */
  readonly #sorted: Float32Array;
  readonly #far: Float64Array;
  readonly #who: Int32Array;
  readonly #here = new Float64Array(3);
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
    this.#sorted = new Float32Array(points.length);
    for (let n = 0; n < this.#order.length; n++)
      for (let a = 0; a < 3; a++) this.#sorted[3 * n + a] = points[3 * this.#order[n] + a];
  }

  /** The nearest k others of a point, in no order; valid until the next call. */
  nearestOthers(i: number): Int32Array {
    return this.nearest(this.points[3 * i], this.points[3 * i + 1], this.points[3 * i + 2], i);
  }

  /** The same of any place, and of a point that does not count. */
  nearest(x: number, y: number, z: number, self = -1): Int32Array {
    this.#count = 0;
    this.#self = self;
    this.#here.set([x, y, z]);
    this.#search(0, this.#order.length, 0, 0, 0, 0);
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

  /** Looks where points are; what is searched is as far away along each axis as these say. */
  #search(begin: number, end: number, axis: number, dx: number, dy: number, dz: number): void {
    if (end - begin <= LEAF) {
      this.#look(begin, end);
      return;
    }
    const middle = (begin + end) >> 1,
      next = axis === 2 ? 0 : axis + 1,
      away = this.#here[axis] - this.#sorted[3 * middle + axis];
    if (away < 0) this.#search(begin, middle, next, dx, dy, dz);
    else this.#search(middle + 1, end, next, dx, dy, dz);
    this.#look(middle, middle + 1);
    if (axis === 0) dx = away;
    else if (axis === 1) dy = away;
    else dz = away;
    if (this.#count === this.k && dx * dx + dy * dy + dz * dz > this.#far[0]) return;
    if (away < 0) this.#search(middle + 1, end, next, dx, dy, dz);
    else this.#search(begin, middle, next, dx, dy, dz);
  }

  /** Keeps the nearest of these. */
  #look(begin: number, end: number): void {
    const x = this.#here[0],
      y = this.#here[1],
      z = this.#here[2],
      sorted = this.#sorted,
      order = this.#order,
      far = this.#far;
    for (let n = begin, at = 3 * begin; n < end; n++, at += 3) {
      const dx = sorted[at] - x,
        dy = sorted[at + 1] - y,
        dz = sorted[at + 2] - z,
        d = dx * dx + dy * dy + dz * dz;
      if (this.#count < this.k) this.#add(d, order[n]);
      else if (d <= far[0]) this.#replace(d, order[n]);
    }
  }

  /** Adds one to a heap that has the farthest at its top. */
  #add(d: number, i: number): void {
    if (i === this.#self) return;
    const far = this.#far,
      who = this.#who;
    let at = this.#count++;
    while (at > 0) {
      const parent = (at - 1) >> 1;
      if (!this.#isNearer(far[parent], who[parent], d, i)) break;
      far[at] = far[parent];
      who[at] = who[parent];
      at = parent;
    }
    far[at] = d;
    who[at] = i;
  }

  /** Puts one in the place of the farthest, if that is farther. */
  #replace(d: number, i: number): void {
    const far = this.#far,
      who = this.#who;
    if (i === this.#self || !this.#isNearer(d, i, far[0], who[0])) return;
    let at = 0;
    for (let child = 1; child < this.k; child = 2 * at + 1) {
      if (child + 1 < this.k && this.#isNearer(far[child], who[child], far[child + 1], who[child + 1])) child++;
      if (!this.#isNearer(d, i, far[child], who[child])) break;
      far[at] = far[child];
      who[at] = who[child];
      at = child;
    }
    far[at] = d;
    who[at] = i;
  }
}
