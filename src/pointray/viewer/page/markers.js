/** Overlays at positions of the model: markers of picked points, the box with their values, the measured line. */

import { projector } from "./camera.js";
import { closeButton } from "./overlay.js";
import { isVector, mix } from "./vector.js";

const LINE = 17; // px from the text of the length to that of its components
const GAP = 14; // px from a marker to its box, and from the box to the window's edge
const NEAR = 1e-3; // near clipping depth of the line, as a fraction of its far depth

const byId = (id) => document.getElementById(id);

const set = (shape, attributes) => {
  for (const [name, value] of Object.entries(attributes)) shape.setAttribute(name, value);
};

export class Markers {
  #view = null; // {camera, aspect} of the shown image
  #points = []; // at most two
  #line = null; // {from, to}
  #box = null; // {position, width, height} px
  #cleared;

  /** cleared: called when the user removes all markers. */
  constructor(cleared) {
    this.#cleared = cleared;
  }

  /** Update for the camera of a new image. */
  follow(camera, aspect) {
    this.#view = { camera, aspect };
    this.redraw();
  }

  /** Mark a picked point, perhaps the second of a measurement, and show its values. */
  pick({ position, lines, second }) {
    if (!isVector(position)) return;
    this.#points = second ? [...this.#points.slice(0, 1), position] : [position];
    if (!second) this.#line = null;
    this.#showBox(position, lines ?? []);
    this.redraw();
  }

  /** Show a measured line. parts: its components along x, y and z, as text */
  measure({ from, to, text, parts }) {
    if (!isVector(from) || !isVector(to)) return;
    this.#points = [from, to];
    this.#line = { from, to };
    byId("line-text").textContent = text;
    byId("line-parts").textContent = (parts ?? []).join("  ");
    this.redraw();
  }

  clear = () => {
    this.#points = [];
    this.#line = this.#box = null;
    this.redraw();
    this.#cleared();
  };

  #showBox(position, lines) {
    const box = byId("picked");
    box.replaceChildren(lines.join("\n"), closeButton(this.clear));
    box.hidden = false;
    this.#box = { position, width: box.offsetWidth, height: box.offsetHeight };
  }

  /** Place everything for the current view. */
  redraw() {
    byId("markers").toggleAttribute("hidden", !this.#points.length);
    if (!this.#box) byId("picked").hidden = true;
    if (!this.#points.length || !this.#view) return;
    const project = projector(this.#view.camera, this.#view.aspect);
    const place = (point) => {
      const { x, y, depth } = project(point);
      return { x: x * window.innerWidth, y: y * window.innerHeight, depth };
    };
    ["first", "second"].forEach((id, number) => this.#drawMarker(byId(id), this.#points[number], place));
    this.#drawLine(place);
    if (this.#box) this.#placeBox(place(this.#box.position));
  }

  #drawMarker(shape, point, place) {
    const { x, y, depth } = point ? place(point) : { depth: 0 };
    shape.toggleAttribute("hidden", !(depth > 0));
    if (depth > 0) shape.setAttribute("transform", `translate(${x} ${y})`);
  }

  #drawLine(place) {
    const ends = this.#line && visiblePart(this.#line.from, this.#line.to, place);
    byId("line").toggleAttribute("hidden", !ends);
    if (!ends) return;
    const [from, to] = ends;
    const places = { x1: from.x, y1: from.y, x2: to.x, y2: to.y };
    for (const stroke of byId("line").querySelectorAll("line")) set(stroke, places);
    const middle = { x: (from.x + to.x) / 2, y: (from.y + to.y) / 2 };
    set(byId("line-text"), middle);
    set(byId("line-parts"), { ...middle, y: middle.y + LINE });
  }

  /** Place the box beside its marker, within the window; hide it if the point is behind the eye. */
  #placeBox({ x, y, depth }) {
    const { width, height } = this.#box;
    const box = byId("picked");
    box.hidden = !(depth > 0);
    const left = x + GAP + width + GAP < window.innerWidth ? x + GAP : x - GAP - width;
    const inside = (value, size, whole) => Math.round(Math.max(GAP, Math.min(whole - size - GAP, value)));
    const shownLeft = inside(left, width, window.innerWidth);
    box.style.transform = `translate(${shownLeft}px, ${inside(y - height / 2, height, window.innerHeight)}px)`;
  }
}

/** Project the ends of a line, clipped in front of the eye; null if all of it is behind. */
function visiblePart(from, to, place) {
  const [a, b] = [place(from), place(to)];
  const least = NEAR * Math.max(a.depth, b.depth);
  if (!(least > 0)) return null;
  const cut = place(mix(from, to, (least - a.depth) / (b.depth - a.depth)));
  return [a.depth < least ? cut : a, b.depth < least ? cut : b];
}
