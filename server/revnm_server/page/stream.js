// Shows a stream of pictures on a canvas, and knows how old they are: an <img> would not say that it stands still.

const STALLED_MS = 2500;
const AGAIN_MS = 1000;
const HEADERS_END = "\r\n\r\n";

export class PictureStream {
  /** Why there is no picture, in the server's words; empty where there is one. */
  trouble = "";
  /** When the picture that is shown was taken, milliseconds, server's clock; null before the first. */
  stampMs = null;
  #canvas;
  #onPicture;
  #opened = null; // ends the stream that is open
  #movedAt = 0;
  #next = null;
  #drawing = false;

  /** `onPicture()` is called when a new one is shown. */
  constructor(canvas, onPicture) {
    this.#canvas = canvas;
    this.#onPicture = onPicture;
  }

  /** Whether no new picture has come for so long that what is shown is old. */
  get stalled() {
    return performance.now() - this.#movedAt > STALLED_MS;
  }

  /** Show the stream at an address, from now on, again whenever it breaks off. */
  open(address) {
    this.close();
    this.#opened = new AbortController();
    this.#movedAt = performance.now();
    this.#run(address, this.#opened.signal);
  }

  /** Look no more, and show nothing. */
  close() {
    this.#opened?.abort();
    this.#opened = this.#next = this.stampMs = null;
    this.trouble = "";
    this.#canvas.width = this.#canvas.width; // clears it
  }

  async #run(address, signal) {
    while (!signal.aborted) {
      try {
        const answer = await fetch(address, { signal });
        this.trouble = answer.ok ? "" : ((await answer.json()).detail ?? "");
        if (answer.ok) await this.#show(answer.body, signal);
      } catch {
        // It broke off, or was closed: what is shown grows old, and the page says so.
      }
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  async #show(body, signal) {
    for await (const part of parts(body.getReader())) {
      if (signal.aborted) return;
      this.#next = part; // where decoding is slow, only the newest is decoded
      if (!this.#drawing) this.#drawNext();
    }
  }

  async #drawNext() {
    this.#drawing = true;
    while (this.#next) {
      const { stampMs, jpeg } = this.#next;
      this.#next = null;
      const [opened, bitmap] = [this.#opened, await createImageBitmap(jpeg).catch(() => null)];
      if (!bitmap || opened !== this.#opened || !opened) continue;
      if (this.#canvas.width !== bitmap.width) this.#canvas.width = bitmap.width;
      if (this.#canvas.height !== bitmap.height) this.#canvas.height = bitmap.height;
      this.#canvas.getContext("2d").drawImage(bitmap, 0, 0);
      bitmap.close();
      this.stampMs = stampMs;
      this.#movedAt = performance.now();
      this.#onPicture();
    }
    this.#drawing = false;
  }
}

/** The parts of a multipart stream: each has a Content-Length and says when its picture was taken. */
async function* parts(reader) {
  let bytes = new Uint8Array(0);
  const text = new TextDecoder("latin1");
  for (;;) {
    const end = text.decode(bytes.subarray(0, 1024)).indexOf(HEADERS_END);
    const head = end < 0 ? null : text.decode(bytes.subarray(0, end));
    const length = head && Number(/content-length: *(\d+)/i.exec(head)?.[1]);
    const start = end + HEADERS_END.length;
    if (head && bytes.length >= start + length) {
      const stampMs = Number(/x-frame-stamp-ms: *([\d.]+)/i.exec(head)?.[1] ?? NaN);
      yield { stampMs, jpeg: new Blob([bytes.subarray(start, start + length)], { type: "image/jpeg" }) };
      bytes = bytes.slice(start + length);
      continue;
    }
    const { done, value } = await reader.read();
    if (done) return;
    const grown = new Uint8Array(bytes.length + value.length);
    grown.set(bytes);
    grown.set(value, bytes.length);
    bytes = grown;
  }
}
