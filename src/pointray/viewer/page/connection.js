/** WebSocket to the server; reconnects every second after a loss. */

const RETRY = 1000; // ms

/** Unpack a binary message: uint32 length of a JSON header, little-endian; the header; the payload. */
function unpack(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  return { header, payload: new Uint8Array(buffer, 4 + size) };
}

export class Connection {
  #socket = null;
  #url;
  #on;

  /**
   * @param {string} url
   * @param {{opened: () => void, closed: () => void, received: (message: object, payload?: Uint8Array) => void}} on
   */
  constructor(url, on) {
    this.#url = url;
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
    const socket = new WebSocket(this.#url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.#on.opened();
    socket.onmessage = (event) => this.#receive(event.data);
    socket.onclose = () => {
      this.#on.closed();
      setTimeout(() => this.#open(), RETRY);
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
