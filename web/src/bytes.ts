// Bounds-checked reading of little-endian bytes. Counterpart of `splatwire.files.byte_io`.

/** Error for bytes that violate the format. */
export class BitstreamError extends Error {
  override readonly name = "BitstreamError";
}

export class ByteReader {
  #at = 0;
  readonly #view: DataView;

  /** Starts at the first byte. `subject` names the data in error messages. */
  constructor(
    readonly bytes: Uint8Array,
    readonly subject: string,
  ) {
    this.#view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  }

  get left(): number {
    return this.bytes.length - this.#at;
  }

  take(size: number): Uint8Array {
    return this.bytes.subarray(this.#advance(size), this.#at);
  }

  u8(): number {
    return this.#view.getUint8(this.#advance(1));
  }

  u32(): number {
    return this.#view.getUint32(this.#advance(4), true);
  }

  f16(): number {
    return floatOf(this.#view.getUint16(this.#advance(2), true));
  }

  f32(): number {
    return this.#view.getFloat32(this.#advance(4), true);
  }

  f64(): number {
    return this.#view.getFloat64(this.#advance(8), true);
  }

  /**
   * Reads an unsigned LEB128 integer: 7 bits per byte, low bits first. The largest value is 2^53 - 1, the last exact
   * double.
   */
  unsigned(): number {
    let value = 0;
    for (let scale = 1; scale < 2 ** 63; scale *= 128) {
      const byte = this.u8();
      value += (byte & 127) * scale;
      if (byte < 128) {
        if (value > Number.MAX_SAFE_INTEGER)
          throw new BitstreamError(`${this.subject}: an integer is larger than 2^53 - 1`);
        return value;
      }
    }
    throw new BitstreamError(`${this.subject}: an integer has more than 9 bytes`);
  }

  /** Reads a signed integer in zigzag coding. */
  signed(): number {
    const value = this.unsigned();
    return value % 2 === 0 ? value / 2 : -(value + 1) / 2;
  }

  blob(): Uint8Array {
    return this.take(this.unsigned());
  }

  rest(): Uint8Array {
    return this.take(this.left);
  }

  finish(): void {
    if (this.left) throw new BitstreamError(`${this.subject}: ${this.left} unexpected bytes at the end`);
  }

  #advance(size: number): number {
    if (size > this.left) throw new BitstreamError(`${this.subject}: ${size} bytes expected, ${this.left} left`);
    this.#at += size;
    return this.#at - size;
  }
}

/** Converts the 16 bits of a half-precision float to a number. */
export function floatOf(half: number): number {
  const exponent = (half >> 10) & 31,
    part = half & 1023,
    sign = half & 32768 ? -1 : 1;
  return (
    sign *
    (exponent === 31 ? (part ? NaN : Infinity) : exponent ? 2 ** (exponent - 15) * (1 + part / 1024) : 2 ** -24 * part)
  );
}

export const hex = (bytes: Uint8Array): string =>
  Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");

export const fromBase64 = (text: string): Uint8Array<ArrayBuffer> =>
  Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
