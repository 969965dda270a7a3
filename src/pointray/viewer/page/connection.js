/**
 * Connection to the server, by a WebSocket or through a notebook.
 *
 * It reconnects every second after a loss; at the user's next input if another view of the widget took its place.
 */

const RETRY = 1000; // ms
const REPLACED = "replaced"; // reason of a closed connection
const INPUTS = ["pointerdown", "wheel", "keydown"];

/** Call a function once, at the user's next input. */
function atNextInput(act) {
  const inputs = new AbortController();
  const once = () => {
    inputs.abort();
    act();
  };
  for (const name of INPUTS) window.addEventListener(name, once, { capture: true, passive: true, signal: inputs.signal });
}

/** Unpack a binary message: uint32 length of a JSON header, little-endian; the header; the payload. */
function unpack(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  return { header, payload: new Uint8Array(buffer, 4 + size) };
}

/** The widget of a notebook that made the frame of this page, with `openSocket` and `shown`; undefined elsewhere. */
export const host = window.frameElement?.pointray;

/** Open a WebSocket at an address relative to the page, which contains the token that the socket needs. */
function openSocket() {
  return host?.openSocket() ?? new WebSocket(new URL("socket", location.href.replace("http", "ws")).href);
}

export class Connection {
  #socket = null;
  #on;

  /**
   * @param {{opened: () => void, closed: (replaced: boolean) => void,
   *   received: (message: object, payload?: Uint8Array) => void}} on
   */
  constructor(on) {
    this.#on = on;
    this.#open();
  }

  get connected() {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Send a message; return false if disconnected. It is then lost, but size and camera are sent again later. */
  send(message) {
    if (this.connected) this.#socket.send(JSON.stringify(message));
    return this.connected;
  }

  #open() {
    const socket = openSocket();
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.#on.opened();
    socket.onmessage = (event) => this.#receive(event.data);
    socket.onclose = ({ reason }) => {
      const replaced = reason === REPLACED;
      this.#on.closed(replaced);
      if (replaced) atNextInput(() => this.#open());
      else setTimeout(() => this.#open(), RETRY);
    };
    this.#socket = socket;
  }

  /** Process a message; an invalid one is logged and ignored. */
  #receive(data) {
    try {
      const { header, payload } = typeof data === "string" ? { header: JSON.parse(data) } : unpack(data);
      this.#on.received(header, payload);
    } catch (error) {
      console.warn("pointray: ignored an invalid message:", error);
    }
  }
}
