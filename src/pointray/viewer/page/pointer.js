/** Mouse, pen and touch input on the image: camera movements and clicks. */

const SLOP = 4; // CSS px, maximum movement in a click
const TAP = 400; // ms, maximum duration of a click by finger or pen
const DOUBLE = 500; // ms, maximum time between the clicks of a double click
const QUERY_DELAY = 250; // ms, so that most double clicks send no query first
const NOTCH = 0.9; // distance factor per notch of the wheel
const PINCH = 10; // px of wheel delta per notch in a trackpad's pinch (reported as ctrl + wheel)
const LARGEST_TURN = 5; // notches, maximum per event

/** Return what a drag does, given the button and keys at its start. */
function dragKind(event) {
  if (event.button !== 0) return "pan";
  if (event.ctrlKey) return "sun";
  return event.shiftKey ? "pan" : "orbit";
}

/** Return notches of the wheel towards the user; fractional for trackpads. */
export function wheelNotches(event) {
  const notch = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 3 : event.deltaY % 120 === 0 ? 120 : 100;
  const pinch = event.ctrlKey && event.deltaMode === WheelEvent.DOM_DELTA_PIXEL && Math.abs(event.deltaY) < 50;
  const notches = event.deltaY / (pinch ? PINCH : notch);
  return Math.max(-LARGEST_TURN, Math.min(LARGEST_TURN, notches));
}

export class Pointer {
  #view;
  #actions;
  #fingers = new Map(); // pointer id -> last position, CSS px
  #press = null; // the gesture in progress
  #click = null; // the last click, while it may become a double click

  /**
   * @param {HTMLElement} view
   * @param {{orbit, pan, sun: (dx: number, dy: number) => void, dolly: (factor: number) => void,
   *   query: (x: number, y: number, extend: boolean) => void, target: (x: number, y: number) => void}} actions
   *   dx, dy: fractions of the view's height; x, y: 0..1 from the left and the top
   */
  constructor(view, actions) {
    this.#view = view;
    this.#actions = actions;
    view.addEventListener("pointerdown", (event) => this.#down(event));
    view.addEventListener("pointermove", (event) => this.#move(event));
    view.addEventListener("pointerup", (event) => this.#up(event));
    view.addEventListener("pointercancel", (event) => this.#lift(event));
    view.addEventListener("lostpointercapture", (event) => this.#lift(event));
    view.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    view.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  #down(event) {
    event.preventDefault(); // no scrolling with the middle button, no text selection
    document.activeElement?.blur(); // keys move the camera again
    this.#view.setPointerCapture(event.pointerId);
    this.#fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (this.#fingers.size > 1) {
      if (this.#press) this.#press.moved = true;
      return;
    }
    const { clientX: x, clientY: y, button, shiftKey, timeStamp } = event;
    this.#press = { x, y, button, shiftKey, time: timeStamp, kind: dragKind(event), moved: false };
  }

  #move(event) {
    const last = this.#fingers.get(event.pointerId);
    if (!last || !this.#press) return;
    const { clientX: x, clientY: y } = event;
    this.#press.moved ||= Math.hypot(x - this.#press.x, y - this.#press.y) >= SLOP;
    if (!this.#press.moved) return;
    if (this.#fingers.size > 1) return this.#pinch(event.pointerId, { x, y });
    this.#fingers.set(event.pointerId, { x, y });
    this.#drag(this.#press.kind, x - last.x, y - last.y);
  }

  #drag(kind, dx, dy) {
    const height = this.#view.clientHeight || 1;
    if (dx || dy) this.#actions[kind](dx / height, dy / height);
  }

  /** Two fingers: their midpoint pans, their distance dollies. */
  #pinch(id, place) {
    const before = this.#grip();
    this.#fingers.set(id, place);
    const after = this.#grip();
    this.#drag("pan", after.x - before.x, after.y - before.y);
    if (after.spread > 0 && before.spread > 0) this.#actions.dolly(before.spread / after.spread);
  }

  #grip() {
    const [a, b] = this.#fingers.values();
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, spread: Math.hypot(a.x - b.x, a.y - b.y) };
  }

  #up(event) {
    const press = this.#press;
    const alone = this.#fingers.size === 1;
    this.#lift(event);
    const brief = event.pointerType === "mouse" || event.timeStamp - press?.time < TAP;
    const still = press && alone && !press.moved && brief;
    if (still && press.button === 0 && press.kind !== "sun") this.#clicked(event, press);
  }

  #lift(event) {
    this.#fingers.delete(event.pointerId);
    if (this.#fingers.size === 0) this.#press = null;
  }

  #clicked(event, { x, y, shiftKey }) {
    const before = this.#click;
    this.#click = null;
    const place = [x / (this.#view.clientWidth || 1), y / (this.#view.clientHeight || 1)];
    const again = before && event.timeStamp - before.time < DOUBLE;
    if (again && Math.hypot(x - before.x, y - before.y) < 2 * SLOP) {
      clearTimeout(before.timer);
      return this.#actions.target(...place);
    }
    const timer = setTimeout(() => this.#actions.query(...place, shiftKey), QUERY_DELAY);
    this.#click = { x, y, time: event.timeStamp, timer };
  }

  #wheel(event) {
    event.preventDefault();
    this.#actions.dolly(NOTCH ** -wheelNotches(event));
  }
}
