/**
 * The pictures: decoded one after the other and shown over the whole window.
 *
 * A "bitmaprenderer" canvas takes the decoded bitmap as it is. Drawing it into a 2D canvas is a copy more: the same CPU
 * time at 640 x 360, an eighth more at 1280 x 720; an <img> of a blob: URL takes 1.2 to 1.8 times as much (Chromium
 * without a graphics card).
 */

export class Picture {
  /** @type {object | null} header of the picture that is shown */
  header = null;
  #newest = -Infinity; // its number
  #canvas;
  #context;
  #drawn;
  #queue = Promise.resolve();
  #age = 0; // which connection the pictures come from

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {(header: object, shown: boolean) => void} drawn  after each picture, also one that could not be read
   */
  constructor(canvas, drawn) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("bitmaprenderer", { alpha: false });
    this.#drawn = drawn;
  }

  /** Width over height of what is shown. */
  get aspect() {
    return this.#canvas.width / this.#canvas.height;
  }

  /** Pictures are counted anew, from another server perhaps; the one that is shown stays. */
  restart() {
    this.#age += 1;
    this.#newest = -Infinity;
  }

  /** Shows a picture after those that came before it. */
  show(header, payload) {
    const age = this.#age;
    const next = async () => {
      const bitmap = await decode(header, payload);
      if (age === this.#age) this.#present(header, bitmap);
    };
    this.#queue = this.#queue.then(next).catch(console.error); // one that fails must not end the others
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

  /** The canvas has the picture's size, and CSS scales it; setting a size clears it, so only a new one is set. */
  #transfer(bitmap) {
    const { width, height } = bitmap;
    if (this.#canvas.width !== width || this.#canvas.height !== height) Object.assign(this.#canvas, { width, height });
    this.#context.transferFromImageBitmap(bitmap);
    this.#canvas.classList.add("drawn");
  }
}

/** The bitmap, or null: a broken picture is passed over. */
async function decode(header, payload) {
  try {
    return await createImageBitmap(new Blob([payload], { type: header.mime ?? "image/jpeg" }));
  } catch (error) {
    console.warn(`pointray: picture ${header.number} cannot be shown:`, error);
    return null;
  }
}
