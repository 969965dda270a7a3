/** The socket to the server: opened again each second when it is lost. */

const RETRY = 1000; // ms

/** A binary message: uint32 length of a JSON header, little-endian; the header; the payload. */
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

  /** Whether it could be sent: what happens while disconnected is dropped, size and camera are sent anew afterwards. */
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

  /** A message that cannot be read must not end the page. */
  #receive(data) {
    try {
      const { header, payload } = typeof data === "string" ? { header: JSON.parse(data) } : unpack(data);
      this.#on.received(header, payload);
    } catch (error) {
      console.warn("pointray: a message was passed over:", error);
    }
  }
}
