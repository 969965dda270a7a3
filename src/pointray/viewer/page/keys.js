/**
 * Keyboard: held keys move the camera, others act once.
 *
 * Keys are identified by position (`code`), so that W A S D work on any keyboard layout.
 */

const FLIGHT = {
  KeyA: [-1, 0, 0],
  KeyD: [1, 0, 0],
  KeyQ: [0, -1, 0],
  KeyE: [0, 1, 0],
  KeyS: [0, 0, -1],
  KeyW: [0, 0, 1],
};

const TURN = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };

const VIEWS = { KeyH: "home", Home: "home" };
["front", "back", "left", "right", "top", "bottom"].forEach((name, number) => {
  VIEWS[`Digit${number + 1}`] = VIEWS[`Numpad${number + 1}`] = name;
});

const TYPED = "input:not([type=checkbox], [type=color], [type=button]), textarea, select, dialog:modal *";

const isTyping = (event) => event.target instanceof Element && event.target.matches(TYPED);

/** Leave a text field on Escape, so that keys move the camera again. */
function leave({ code, target }) {
  if (code === "Escape") target.blur();
}

/** Sum the directions of held keys; opposite ones cancel. */
function direction(table, held, length) {
  const ways = [...held].map((code) => table[code]).filter(Boolean);
  return Array.from({ length }, (_, axis) => ways.reduce((sum, way) => sum + way[axis], 0));
}

export class Keys {
  #held = new Set();
  #actions;

  /**
   * @param {{hold: (keys: {flight: number[], turn: number[], fast: boolean}) => void, view: (name: string) => void,
   *   clear: () => void, help: () => void, plain: () => void, project: () => void}} actions
   */
  constructor(actions) {
    this.#actions = actions;
    // Capture phase: the panel stops key events from bubbling, but a click on its buttons must not stop a flight.
    window.addEventListener("keydown", (event) => this.#down(event), true);
    window.addEventListener("keyup", (event) => this.#up(event), true);
    window.addEventListener("blur", () => this.#release());
  }

  #down(event) {
    if (isTyping(event)) return leave(event);
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const acted = this.#hold(event) || this.#act(event);
    if (acted) event.preventDefault();
  }

  #hold(event) {
    const moves = event.code in FLIGHT || event.code in TURN;
    if (moves) this.#held.add(event.code);
    if (moves || event.key === "Shift") this.#report(event.shiftKey);
    return moves;
  }

  #act(event) {
    const { key, code } = event;
    const { view, clear, help, plain, project } = this.#actions;
    const isHelp = key === "?" || key === "F1";
    const act = isHelp ? help : { Escape: clear, KeyP: plain, KeyO: project }[code] ?? (VIEWS[code] && (() => view(VIEWS[code])));
    if (act && !event.repeat) act();
    return Boolean(act);
  }

  #up(event) {
    if (this.#held.delete(event.code) || event.key === "Shift") this.#report(event.shiftKey);
  }

  #release() {
    this.#held.clear();
    this.#report(false);
  }

  #report(fast) {
    const flight = direction(FLIGHT, this.#held, 3);
    this.#actions.hold({ flight, turn: direction(TURN, this.#held, 2), fast });
  }
}
