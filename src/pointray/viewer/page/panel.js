/** The panel: lil-gui built from the server's description, what the user changes sent back. */

import { addControl } from "./controls.js";
import { GUI } from "./lil-gui.esm.min.js";

const PAUSE = 50; // ms between two values of one control
const NARROW = 600; // CSS px; a panel in a narrower window is closed unless it is at work

export class Panel {
  #container;
  #send;
  #gui = null;
  #title = "pointray";
  #controls = new Map(); // name -> {show}
  #toggled = new Map(); // title -> whether the user left it open; the panel itself has none
  #narrow = isNarrow();
  #changes = new Map(); // name -> value that is still to be sent
  #timer = 0;
  #held = null; // name of the control under a pressed pointer
  #late = new Map(); // values that came for it meanwhile

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

  /** All of the panel anew; folders stay as the user left them. */
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
   * What it takes of the window, null for nothing. An open one may grow down to the window's edge; in a narrow window it
   * opens over the picture for a moment, and only its title counts.
   */
  get box() {
    const title = this.#gui?.$title.getBoundingClientRect();
    if (!title?.height) return null;
    const { left, right } = this.#gui.domElement.getBoundingClientRect();
    return { left, right, top: 0, bottom: this.#narrow || this.#gui._closed ? title.bottom : window.innerHeight };
  }

  /** The window has another size: one that has become narrow has no room for an open panel. */
  resized() {
    if (isNarrow() === this.#narrow) return;
    this.#narrow = isNarrow();
    this.#toggled.delete("");
    this.#fold(this.#narrow);
  }

  /** The user turns to the picture: in a narrow window the panel goes out of its way. */
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

  /** New values of controls, which are not sent back. A control in the user's hand takes its own when let go. */
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
    this.#sendChanges(); // the button acts on what the user sees
    this.#send({ type: "press", name });
  }

  /** Sends what has changed, and again after a pause as long as there is more. */
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
