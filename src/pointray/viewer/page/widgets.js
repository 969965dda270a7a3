/** Controllers missing in lil-gui. Each edits {value} and calls onChange like lil-gui's own. */

import { Controller, NumberController } from "./lil-gui.esm.min.js";

const DIGITS = 10; // significant digits shown: map coordinates in metres to the millimetre
const SHORT = 6; // beside a slider, where there is less space
const SLIDER_DIGITS = 3; // digits of a logarithmic slider's values
const KEY_STEP = 1.05; // factor per arrow key on a logarithmic value

const rounded = (value, digits) => (Number.isInteger(value) ? value : Number(value.toPrecision(digits)));
const readable = (value, digits = DIGITS) => String(rounded(value, digits));

const element = (name, className) => Object.assign(document.createElement(name), { className });

/** Create a number field; `typed` is called with each completed input. */
function numberField(label, typed) {
  const field = element("input", "");
  field.type = "text";
  field.inputMode = "decimal";
  field.setAttribute("aria-labelledby", label.id);
  field.addEventListener("focus", () => field.select());
  field.addEventListener("change", () => typed(Number(field.value.trim().replace(",", "."))));
  field.addEventListener("keydown", (event) => event.key === "Enter" && field.blur());
  return field;
}

/** lil-gui's number or slider, showing fewer than 17 digits. */
export class NumberField extends NumberController {
  constructor(folder, model, { min, max, step }) {
    super(folder, model, "value", min ?? undefined, max ?? undefined, step ?? undefined);
  }

  updateDisplay() {
    super.updateDisplay();
    const digits = this._hasSlider ? SHORT : DIGITS;
    if (document.activeElement !== this.$input) this.$input.value = readable(this.getValue(), digits);
    return this;
  }
}

/** Logarithmic slider for a positive value; the field shows the value itself. */
export class LogarithmicRange extends Controller {
  constructor(folder, model, { min, max, step }) {
    super(folder, model, "value", "lil-number");
    Object.assign(this, { min, max, step });
    this.domElement.classList.add("lil-has-slider");
    this.slider = element("div", "lil-slider");
    this.fill = this.slider.appendChild(element("div", "lil-fill"));
    this.field = numberField(this.$name, (value) => this.#set(value));
    this.$disable = this.field;
    this.$widget.append(this.slider, this.field);
    this.#listen();
    this.updateDisplay();
  }

  updateDisplay() {
    const share = Math.log(this.getValue() / this.min) / Math.log(this.max / this.min);
    this.fill.style.width = `${100 * Math.min(1, Math.max(0, share || 0))}%`;
    this.field.value = readable(this.getValue(), SHORT);
    return this;
  }

  #listen() {
    const { slider, field } = this;
    slider.addEventListener("pointerdown", (event) => {
      slider.setPointerCapture(event.pointerId);
      this.#slide(event);
    });
    slider.addEventListener("pointermove", (event) => {
      if (slider.hasPointerCapture(event.pointerId)) this.#slide(event);
    });
    field.addEventListener("keydown", (event) => {
      const power = { ArrowUp: 1, ArrowDown: -1 }[event.key];
      if (!power) return;
      event.preventDefault();
      this.#set(rounded(this.getValue() * KEY_STEP ** power, SLIDER_DIGITS));
    });
  }

  #slide(event) {
    const { left, width } = this.slider.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - left) / width));
    const value = this.min * (this.max / this.min) ** share;
    const stepped = this.step > 0 && value > this.step ? Math.round(value / this.step) * this.step : value;
    this.#set(rounded(stepped, stepped === value ? SLIDER_DIGITS : DIGITS));
  }

  #set(value) {
    if (Number.isFinite(value)) this.setValue(Math.min(this.max, Math.max(this.min, value)));
    this.updateDisplay();
  }
}

/** Three numbers side by side. */
export class VectorFields extends Controller {
  constructor(folder, model) {
    super(folder, model, "value", "vector");
    this.fields = [0, 1, 2].map((axis) => numberField(this.$name, (value) => this.#set(axis, value)));
    this.$widget.append(...this.fields);
    this.updateDisplay();
  }

  updateDisplay() {
    this.fields.forEach((field, axis) => {
      field.value = readable(this.getValue()[axis]);
    });
    return this;
  }

  #set(axis, value) {
    if (Number.isFinite(value)) this.setValue(this.getValue().with(axis, value));
    this.updateDisplay();
  }
}

/** Read-only text. */
export class Note extends Controller {
  constructor(folder, model) {
    super(folder, model, "value", "note");
    this.updateDisplay();
  }

  updateDisplay() {
    this.$widget.textContent = this.getValue();
    return this;
  }
}
