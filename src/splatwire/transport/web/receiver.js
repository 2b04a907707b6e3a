// A receiver of splatwire streams in a browser: WebTransport, side information on a reliable stream, packets as
// datagrams. The datagrams are those of docs/transport.md; erasure coding is not needed here, lost packets are asked
// for again until `deadline`.

const VERSION = 3;
const REQUEST = 3, WELCOME = 4, SIDE = 5, DATA = 6, FEEDBACK = 8, BYE = 9, REFUSE = 10, END = 11;
const REFUSALS = ["", "no such stream", "the server is full", "the server stopped",
  "too many transfers from this network"];
const FEEDBACK_MS = 20, AGAIN_MS = 120, REORDER = 48, MOST_NACKS = 250, MOST_AHEAD = 2 ** 17, ENDS_IN_VAIN = 25;
const HANDSHAKES = 5, HANDSHAKE_PAUSE_MS = 100;
const MOST_HEAD_BYTES = 2 ** 28, MOST_PACKETS = 2 ** 21, MOST_DATAGRAM = 1200;
const MOST_TIERS = 10, MOST_PREVIEW = 1024;

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n >>> 0;
});

export function crc32(bytes, crc = 0) {
  crc = ~crc >>> 0;
  for (const byte of bytes) crc = CRC_TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

const view = (bytes) => new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);

// One of our frames: byte 0, what `fill` writes behind it, and a CRC-32 of all that.
function frame(kind, size, fill) {
  const bytes = new Uint8Array(1 + size + 4), numbers = view(bytes);
  bytes[0] = (VERSION << 4) | kind;
  fill(numbers, bytes);
  numbers.setUint32(1 + size, crc32(bytes.subarray(0, 1 + size)), true);
  return bytes;
}

function kindOf(bytes) {
  if (bytes.length < 6 || bytes[0] >> 4 !== VERSION) return 0;
  const kind = bytes[0] & 15;
  if (kind === DATA) return kind; // the packet in it has a checksum of its own
  const end = bytes.length - 4;
  return crc32(bytes.subarray(0, end)) === view(bytes).getUint32(end, true) ? kind : 0;
}

// What a welcome shows of the scene, which may be empty (docs/format.md, section `preview`); null if its sizes contradict
// each other.
function previewOf(bytes) {
  const numbers = view(bytes), tiers = bytes[69], at = 70 + 8 * tiers;
  if (!(tiers >= 1 && tiers <= MOST_TIERS) || at + 2 > bytes.length - 4) return null;
  const size = numbers.getUint16(at, true);
  return size <= MOST_PREVIEW && at + 2 + size === bytes.length - 4 ? bytes.slice(at + 2, at + 2 + size) : null;
}

// The state of one transfer; bytes and time in, bytes out, as in the Python core.
export class Transfer {
  constructor(name, nonce, now) {
    this.name = new TextEncoder().encode(name);
    this.nonce = nonce;
    this.began = now;
    this.welcome = null;
    this.head = null;
    this.headSymbols = 0;
    this.headComplete = false;
    this.packets = new Map();
    this.asked = new Map();
    this.counts = { bytes: 0, datagrams: 0, rejected: 0, duplicates: 0, packets: 0, packetBytes: 0 };
    this.largest = -1;
    this.largestAt = now;
    this.received = 0;
    this.highest = -1;
    this.endedAt = null;
    this.endsInVain = 0;
    this.finished = null;
    this.sideInfoMs = null;
  }

  request() {
    return frame(REQUEST, 8 + 16 + 1 + this.name.length, (numbers, bytes) => {
      numbers.setBigUint64(1, this.nonce, true);
      bytes[25] = this.name.length;
      bytes.set(this.name, 26);
    });
  }

  receive(bytes, now) {
    if (this.finished) return;
    const kind = kindOf(bytes);
    this.counts.bytes += bytes.length;
    if (kind === WELCOME && !this.welcome) return this.welcomed(bytes, now);
    if (kind === REFUSE && !this.welcome) return void (this.finished = REFUSALS[bytes[9]] || "the server refused");
    const numbers = view(bytes);
    if (!this.welcome || ![SIDE, DATA, END].includes(kind) || numbers.getUint32(1, true) !== this.welcome.session) {
      this.counts.rejected++;
      return;
    }
    if (kind === SIDE) return this.side(bytes, numbers, now);
    const sequence = numbers.getUint32(5, true);
    if (sequence > this.largest + MOST_AHEAD) return void this.counts.rejected++;
    this.counts.datagrams++;
    this.received++;
    if (sequence > this.largest) [this.largest, this.largestAt] = [sequence, now];
    if (kind === END) {
      this.endedAt ??= now;
      this.endsInVain++;
    } else {
      this.endsInVain = 0;
      this.data(bytes, numbers);
    }
    this.look();
  }

  welcomed(bytes, now) {
    const numbers = view(bytes);
    const preview = previewOf(bytes);
    if (!preview) return void (this.finished = "the server announces something impossible");
    const welcome = {
      preview,
      session: numbers.getUint32(9, true),
      streamId: numbers.getUint32(13, true),
      headBytes: Number(numbers.getBigUint64(17, true)),
      digest: bytes.slice(25, 57),
      symbolBytes: numbers.getUint16(57, true),
      packets: numbers.getUint32(59, true),
      packetBytes: numbers.getUint16(63, true),
      carried: numbers.getUint32(65, true),
    };
    const fine = numbers.getBigUint64(1, true) === this.nonce && welcome.headBytes <= MOST_HEAD_BYTES &&
      welcome.headBytes > 0 && welcome.symbolBytes > 0 && welcome.packets <= MOST_PACKETS &&
      welcome.carried <= welcome.packets;
    if (!fine) return void (this.finished = "the server announces something impossible");
    this.welcome = welcome;
    this.head = new Uint8Array(welcome.headBytes);
    this.numSymbols = Math.ceil(welcome.headBytes / welcome.symbolBytes);
    this.segments = Math.ceil(this.numSymbols / 2048);
    this.seen = new Uint8Array(this.numSymbols);
  }

  side(bytes, numbers, now) {
    const { symbolBytes, headBytes } = this.welcome;
    const segment = numbers.getUint16(9, true), symbol = numbers.getUint32(11, true);
    const payload = bytes.subarray(15, bytes.length - 4);
    const first = Math.floor((this.numSymbols * segment) / this.segments);
    const next = Math.floor((this.numSymbols * (segment + 1)) / this.segments);
    const at = first + symbol;
    const wrong = segment >= this.segments || at >= next || payload.length !== symbolBytes;
    if (wrong || this.seen[at]) return void this.counts.rejected++;
    this.head.set(payload.subarray(0, Math.min(symbolBytes, headBytes - at * symbolBytes)), at * symbolBytes);
    this.seen[at] = 1;
    if (++this.headSymbols === this.numSymbols) {
      this.headComplete = true;
      this.sideInfoMs = now - this.began;
      if (!this.carried()) this.finished = "the side information is damaged";
      this.look();
    }
  }

  // The first packets, which lie behind manifest and side information; false if they are not what was announced.
  carried() {
    const head = view(this.head);
    let at, place = 0;
    try {
      const manifestEnd = 4 + head.getUint32(0, true);
      const manifest = JSON.parse(new TextDecoder().decode(this.head.subarray(4, manifestEnd)));
      at = manifestEnd + manifest.side_info_bytes;
    } catch {
      return false;
    }
    for (; at + 2 <= this.head.length; place++) {
      const size = head.getUint16(at, true);
      if (at + 2 + size > this.head.length || place >= this.welcome.carried) return false;
      this.take(place, this.head.slice(at + 2, at + 2 + size));
      at += 2 + size;
    }
    return place === this.welcome.carried && at === this.head.length;
  }

  data(bytes, numbers) {
    const place = numbers.getUint32(9, true);
    this.take(place, bytes.slice(13));
    this.highest = Math.max(this.highest, this.packets.has(place) ? place : -1);
  }

  take(place, packet) {
    const inside = view(packet);
    const fine = place < this.welcome.packets && packet.length > 16 && packet.length <= this.welcome.packetBytes &&
      inside.getUint32(1, true) === this.welcome.streamId &&
      crc32(packet.subarray(16), crc32(packet.subarray(0, 12))) === inside.getUint32(12, true);
    if (!fine) return void this.counts.rejected++;
    if (this.packets.has(place)) return void this.counts.duplicates++;
    this.packets.set(place, packet);
    this.counts.packets++;
    this.counts.packetBytes += packet.length;
  }

  look() {
    if (!this.headComplete) return;
    if (this.packets.size === this.welcome.packets) this.finished = "complete";
    else if (this.endsInVain >= ENDS_IN_VAIN) this.finished = "sent";
  }

  feedback(now) {
    const nacks = [];
    const stop = this.endedAt === null ? this.highest + 1 - REORDER : this.welcome.packets;
    for (let place = this.headComplete ? 0 : this.welcome.carried; place < stop && nacks.length < MOST_NACKS; place++) {
      if (this.packets.has(place) || now - (this.asked.get(place) ?? -1e9) < AGAIN_MS) continue;
      this.asked.set(place, now);
      nacks.push(place);
    }
    return frame(FEEDBACK, 22 + 4 * nacks.length, (numbers) => {
      numbers.setUint32(1, this.welcome.session, true);
      numbers.setUint32(5, Math.max(this.largest, 0), true);
      numbers.setUint32(9, Math.min(this.received, this.largest + 1), true);
      numbers.setUint32(13, Math.round(this.largestAt * 1000) % 2 ** 32, true);
      numbers.setUint32(17, this.headComplete ? 0 : this.numSymbols - this.headSymbols, true);
      numbers.setUint16(21, nacks.length, true);
      nacks.forEach((place, n) => numbers.setUint32(23 + 4 * n, place, true));
    });
  }

  bye() {
    return frame(BYE, 4, (numbers) => numbers.setUint32(1, this.welcome.session, true));
  }
}

// Cuts a stream into frames: each behind its size, u16.
export class FrameReader {
  #rest = new Uint8Array();

  feed(chunk) {
    const bytes = new Uint8Array(this.#rest.length + chunk.length), frames = [];
    bytes.set(this.#rest);
    bytes.set(chunk, this.#rest.length);
    let at = 0;
    while (bytes.length - at >= 2) {
      const size = bytes[at] | (bytes[at + 1] << 8);
      if (size < 1 || size > MOST_DATAGRAM) throw new Error(`a frame of ${size} bytes on the stream`);
      if (bytes.length - at < 2 + size) break;
      frames.push(bytes.slice(at + 2, at + 2 + size));
      at += 2 + size;
    }
    this.#rest = bytes.slice(at);
    return frames;
  }
}

const hex = (buffer) => Array.from(new Uint8Array(buffer), (byte) => byte.toString(16).padStart(2, "0")).join("");
export const sha256 = async (bytes) => hex(await crypto.subtle.digest("SHA-256", bytes));

// A session that is open. A first flight that loses its first datagram can make the server refuse the handshake, so it
// is tried again, each time after a longer pause; the last refusal is the error.
async function openSession(url, options) {
  for (let attempt = 1; ; attempt++) {
    const transport = new WebTransport(url, options);
    const closed = transport.closed.then(() => "the session ended", (error) => `the session ended: ${error.message}`);
    try {
      await transport.ready;
      return { transport, closed };
    } catch (error) {
      if (attempt === HANDSHAKES) throw error;
    }
    await new Promise((resolve) => setTimeout(resolve, HANDSHAKE_PAUSE_MS * attempt));
  }
}

// Receives one stream. `fingerprint`: SHA-256 of a self-signed certificate, hexadecimal; null for a certificate that
// the browser knows. `deadline`: seconds, null waits for everything. `show` is called with the transfer as it goes on.
export async function receive({ url, name = "", fingerprint = null, deadline = null, show = () => {} }) {
  const options = { requireUnreliable: true, congestionControl: "low-latency" };
  if (fingerprint) {
    const value = Uint8Array.from(fingerprint.match(/../g), (digits) => parseInt(digits, 16));
    options.serverCertificateHashes = [{ algorithm: "sha-256", value }];
  }
  const transfer = new Transfer(name, crypto.getRandomValues(new BigUint64Array(1))[0], performance.now());
  const { transport, closed } = await openSession(url, options);
  const give = (reason) => { transfer.finished ??= reason; };
  closed.then(give);
  const stream = await transport.createBidirectionalStream();
  const onStream = stream.writable.getWriter(), datagrams = transport.datagrams.writable.getWriter();
  const request = transfer.request();
  await onStream.write(Uint8Array.of(request.length & 255, request.length >> 8, ...request));
  const readStream = async () => {
    const frames = new FrameReader();
    for await (const chunk of stream.readable) {
      for (const bytes of frames.feed(chunk)) transfer.receive(bytes, performance.now());
    }
  };
  const readDatagrams = async () => {
    const reader = transport.datagrams.readable.getReader();
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      transfer.receive(value, performance.now());
    }
  };
  readStream().catch((error) => give(error.message));
  readDatagrams().catch((error) => give(error.message));
  while (!transfer.finished) {
    await new Promise((resolve) => setTimeout(resolve, FEEDBACK_MS));
    const now = performance.now();
    if (deadline !== null && now - transfer.began > 1000 * deadline) give("deadline");
    else if (transfer.welcome) datagrams.write(transfer.feedback(now)).catch(() => {});
    show(transfer);
  }
  if (transfer.welcome) for (let n = 0; n < 3; n++) await datagrams.write(transfer.bye()).catch(() => {});
  show(transfer);
  if (transfer.headComplete && await sha256(transfer.head) !== hex(transfer.welcome.digest)) {
    transfer.headComplete = false;
    transfer.finished = "the side information is damaged";
  }
  transport.close();
  return transfer;
}

// All packets in sending order, one after another, for a digest of what arrived.
export function joined(transfer) {
  const all = new Uint8Array(transfer.counts.packetBytes);
  let at = 0;
  for (const place of [...transfer.packets.keys()].sort((a, b) => a - b)) {
    all.set(transfer.packets.get(place), at);
    at += transfer.packets.get(place).length;
  }
  return all;
}
