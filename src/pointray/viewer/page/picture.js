/**
 * Images: decoded in order and shown over the whole window.
 *
 * A "bitmaprenderer" canvas takes over the decoded bitmap. A 2D canvas needs another copy: the same CPU
 * time at 640 x 360, an eighth more at 1280 x 720; an <img> of a blob: URL takes 1.2 to 1.8 times as much (Chromium
 * without a graphics card).
 */

export class Picture {
  /** @type {object | null} header of the shown image */
  header = null;
  #newest = -Infinity; // number of the newest shown image
  #canvas;
  #context;
  #drawn;
  #queue = Promise.resolve();
  #age = 0; // counts connections

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(header: object, shown: boolean) => void} drawn  after each image, also one that could not be decoded
   */
  constructor(canvas, drawn) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("bitmaprenderer", { alpha: false });
    this.#drawn = drawn;
  }

  /** Width over height of the shown image. */
  get aspect() {
    return this.#canvas.width / this.#canvas.height;
  }

  /** Reset for a new connection, whose image numbers start again; the shown image stays. */
  restart() {
    this.#age += 1;
    this.#newest = -Infinity;
  }

  /** Show an image after those received before it. */
  show(header, payload) {
    const age = this.#age;
    const next = async () => {
      const bitmap = await decode(header, payload);
      if (age === this.#age) this.#present(header, bitmap);
    };
    this.#queue = this.#queue.then(next).catch(console.error); // a failure must not stop later images
  }

  #present(header, bitmap) {
    const shown = bitmap !== null && header.number >= this.#newest;
    if (shown) {
      this.#transfer(bitmap);
      this.#newest = header.number;
      this.header = header;
    }
    this.#drawn(header, shown);
  }

  /** Show a bitmap at its own size, scaled by CSS. Setting a canvas size clears it, so it is set only if it differs. */
  #transfer(bitmap) {
    const { width, height } = bitmap;
    if (this.#canvas.width !== width || this.#canvas.height !== height) Object.assign(this.#canvas, { width, height });
    this.#context.transferFromImageBitmap(bitmap);
    this.#canvas.classList.add("drawn");
  }
}

/** Decode an image; null if it is damaged. */
async function decode(header, payload) {
  try {
    return await createImageBitmap(new Blob([payload], { type: header.mime ?? "image/jpeg" }));
  } catch (error) {
    console.warn(`pointray: picture ${header.number} cannot be decoded:`, error);
    return null;
  }
}
