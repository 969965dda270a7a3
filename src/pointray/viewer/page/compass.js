/** Scale bar in orthographic views, and north arrow for georeferenced scans. */

import { heightAtTarget, viewAxes } from "./camera.js";
import { dot, isVector } from "./vector.js";

const LONGEST = 160; // CSS px, maximum length of the bar
const STEEPEST = 0.1; // minimum projected length of north; the arrow is hidden in views nearly along north

const byId = (id) => document.getElementById(id);

/** Return the greatest 1, 2 or 5 times a power of ten that does not exceed a length. */
export function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const digit = [5, 2, 1].find((step) => step * power <= length * (1 + 1e-9)) ?? 1;
  return Number((digit * power).toPrecision(1)); // avoids 0.30000000000000004
}

export class Compass {
  #camera = null; // camera of the shown image
  #north = null; // unit vector, null if unknown

  setNorth(north) {
    this.#north = isVector(north) ? north : null;
    this.redraw();
  }

  /** Update for the camera of a new image. */
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
