/** What a map has: a scale bar in orthographic views, and where north is if the scan is georeferenced. */

import { heightAtTarget, viewAxes } from "./camera.js";
import { dot, isVector } from "./vector.js";

const LONGEST = 160; // CSS px of the bar
const STEEPEST = 0.1; // of north's length must be seen, else the view is along it and the arrow means nothing

const byId = (id) => document.getElementById(id);

/** The greatest 1, 2 or 5 times a power of ten that is not above a length. */
export function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const digit = [5, 2, 1].find((step) => step * power <= length * (1 + 1e-9)) ?? 1;
  return Number((digit * power).toPrecision(1)); // no 0.30000000000000004
}

export class Compass {
  #camera = null; // of the picture that is shown
  #north = null; // unit vector, null where nobody knows

  setNorth(north) {
    this.#north = isVector(north) ? north : null;
    this.redraw();
  }

  /** With the camera of another picture. */
  follow(camera) {
    this.#camera = camera;
    this.redraw();
  }

  redraw() {
    this.#drawScale();
    this.#drawNorth();
  }

  #drawScale() {
    const bar = byId("scale");
    bar.hidden = !this.#camera?.orthographic;
    if (bar.hidden) return;
    const unit = window.innerHeight / heightAtTarget(this.#camera); // px
    const length = roundLength(LONGEST / unit);
    bar.style.width = `${length * unit}px`;
    bar.textContent = String(length);
  }

  #drawNorth() {
    const arrow = byId("north");
    const axes = this.#north && this.#camera && viewAxes(this.#camera);
    const [x, y] = axes ? [dot(this.#north, axes.right), dot(this.#north, axes.top)] : [0, 0];
    arrow.toggleAttribute("hidden", Math.hypot(x, y) < STEEPEST);
    byId("needle").setAttribute("transform", `rotate(${(Math.atan2(x, y) * 180) / Math.PI})`);
  }
}
