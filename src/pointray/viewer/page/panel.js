/** The panel: lil-gui built from the server's description; changes are sent to the server. */

import { addControl } from "./controls.js";
import { GUI } from "./lil-gui.esm.min.js";

const PAUSE = 50; // ms between two values of a control
const NARROW = 600; // CSS px; in narrower windows the panel is closed when not in use

export class Panel {
  #container;
  #send;
  #gui = null;
  #title = "pointray";
  #controls = new Map(); // name -> {show}
  #toggled = new Map(); // title -> whether the user left it open; "" is the panel itself
  #narrow = isNarrow();
  #changes = new Map(); // name -> value not sent yet
  #timer = 0;
  #held = null; // name of the control being dragged
  #late = new Map(); // values received for it meanwhile

  /** @param {HTMLElement} container  @param {(message: object) => void} send */
  constructor(container, send) {
    this.#container = container;
    this.#send = send;
    container.addEventListener("pointerdown", (event) => {
      this.#held = event.target.closest("[data-name]")?.dataset.name ?? null;
    });
    for (const end of ["pointerup", "pointercancel"]) window.addEventListener(end, () => this.#release());
  }

  setTitle(title) {
    this.#title = title;
    this.#gui?.title(title);
  }

  /** Rebuild the panel; folders stay open or closed as the user left them. */
  build(folders) {
    const scrolled = this.#gui?.$children.scrollTop ?? 0;
    this.#gui?.destroy();
    this.#controls.clear();
    this.#gui = new GUI({ container: this.#container, title: this.#title, injectStyles: false });
    for (const folder of folders) this.#addFolder(folder);
    this.#gui.open(this.#toggled.get("") ?? !this.#narrow);
    this.#gui.onOpenClose((gui) => this.#toggled.set(gui === this.#gui ? "" : gui._title, !gui._closed));
    this.#gui.$children.scrollTop = scrolled;
  }

  get built() {
    return this.#gui !== null;
  }

  /**
   * Bounds of the panel, null if hidden. An open panel counts down to the window's edge, since it may grow. In a narrow
   * window it covers the image only briefly, and only its title counts.
   */
  get box() {
    const title = this.#gui?.$title.getBoundingClientRect();
    if (!title?.height) return null;
    const { left, right } = this.#gui.domElement.getBoundingClientRect();
    return { left, right, top: 0, bottom: this.#narrow || this.#gui._closed ? title.bottom : window.innerHeight };
  }

  /** Handle a new window size: close the panel when the window becomes narrow, open it when it becomes wide. */
  resized() {
    if (isNarrow() === this.#narrow) return;
    this.#narrow = isNarrow();
    this.#toggled.delete("");
    this.#fold(this.#narrow);
  }

  /** Close the panel in a narrow window, when the user works in the image. */
  yield() {
    if (this.#narrow) this.#fold(true);
  }

  #fold(folded) {
    this.#gui?.open(!folded);
  }

  #addFolder({ title, open = true, controls = [] }) {
    const folder = this.#gui.addFolder(String(title));
    for (const control of controls) this.#addControl(folder, control);
    folder.open(this.#toggled.get(folder._title) ?? open);
  }

  #addControl(folder, control) {
    const { name } = control;
    const shown = addControl(folder, control, {
      changed: (value) => this.#changed(name, value),
      pressed: () => this.#pressed(name),
    });
    if (shown) this.#controls.set(name, shown);
  }

  /** Show new values of controls without sending them back. A control being dragged is updated on release. */
  setValues(values) {
    for (const [name, value] of Object.entries(values)) {
      if (name === this.#held) this.#late.set(name, value);
      else this.#controls.get(name)?.show(value);
    }
  }

  #release() {
    this.#held = null;
    const late = Object.fromEntries(this.#late);
    this.#late.clear();
    this.setValues(late);
  }

  #changed(name, value) {
    this.#changes.set(name, value);
    if (!this.#timer) this.#flush();
  }

  #pressed(name) {
    this.#sendChanges(); // so that the button acts on the values shown
    this.#send({ type: "press", name });
  }

  /** Send changes, and repeat after a pause while there are more. */
  #flush() {
    this.#timer = this.#changes.size ? setTimeout(() => this.#flush(), PAUSE) : 0;
    this.#sendChanges();
  }

  #sendChanges() {
    for (const [name, value] of this.#changes) this.#send({ type: "set", name, value });
    this.#changes.clear();
  }
}

function isNarrow() {
  return window.innerWidth <= NARROW;
}
