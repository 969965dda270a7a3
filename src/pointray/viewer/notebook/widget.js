/**
 * Widget of a notebook: the viewer's page in a frame, connected by the widget's own messages instead of a WebSocket.
 *
 * The frame isolates the page from the notebook, its styles, its keys and other widgets. It is made from a text, so that
 * nothing is requested from a server. Python inserts the files of the page.
 */

const PAGE = PAGE_OF_POINTRAY;
const ACKNOWLEDGED = 1 << 18; // bytes read before they are acknowledged
const WAITING = "Waiting for the kernel. If it has stopped, run the cell again.";

const newId = () => Array.from(crypto.getRandomValues(new Uint32Array(4)), (part) => part.toString(36)).join("-");

/** Copy a buffer of a message, a DataView into a larger one, to an ArrayBuffer of its own. */
const copied = ({ buffer, byteOffset, byteLength }) => buffer.slice(byteOffset, byteOffset + byteLength);

/** Socket with the part of WebSocket's interface that the page uses. */
class CommSocket {
  readyState = WebSocket.CONNECTING;
  #model;
  #view = newId();
  #read = 0; // bytes not acknowledged yet
  #pieces = []; // of a file
  #listener = (content, buffers) => this.#receive(content, buffers ?? []);

  constructor(model) {
    this.#model = model;
    model.on("msg:custom", this.#listener);
    this.#post({ state: "open" });
  }

  send(text) {
    this.#post({ text });
  }

  /** End the connection: the page is gone. */
  close() {
    if (this.readyState === WebSocket.CLOSED) return;
    this.#post({ state: "closed" });
    this.#end();
  }

  /** Note that the connection is lost. reason : state of the kernel's last message; empty if there was none */
  lose(reason = "") {
    if (this.readyState === WebSocket.CLOSED) return;
    this.#end();
    this.onclose?.({ reason });
  }

  #end() {
    this.readyState = WebSocket.CLOSED;
    this.#model.off("msg:custom", this.#listener);
  }

  /** Send a message; it is lost if the kernel has stopped. */
  #post(content) {
    try {
      Promise.resolve(this.#model.send({ view: this.#view, ...content })).catch(() => {});
    } catch {
      // The notebook has closed the connection to the kernel.
    }
  }

  #receive(content, buffers) {
    if (content?.view !== this.#view) return; // of another view of the same widget
    if (content.state === "opened") {
      this.readyState = WebSocket.OPEN;
      this.onopen?.();
    } else if (content.state) return this.lose(content.state);
    else if (content.piece) this.#addPiece(content.piece, copied(buffers[0]));
    else this.onmessage?.({ data: content.text ?? copied(buffers[0]) });
    this.#acknowledge(content.bytes);
  }

  #addPiece(piece, data) {
    this.#pieces.push(data);
    if (piece !== "last") return;
    const pieces = this.#pieces;
    this.#pieces = [];
    new Blob(pieces).arrayBuffer().then((whole) => this.onmessage?.({ data: whole }));
  }

  #acknowledge(bytes) {
    this.#read += bytes;
    if (this.#read < ACKNOWLEDGED) return;
    this.#post({ read: this.#read });
    this.#read = 0;
  }
}

/** Make the modules of the page loadable; return the address of the main one, and a function that releases them. */
function loadable() {
  const addresses = new Map();
  const addressOf = (name) => {
    if (!addresses.has(name)) {
      const linked = PAGE.modules[name].replace(/from "\.\/([\w.-]+)"/g, (_, other) => `from "${addressOf(other)}"`);
      addresses.set(name, URL.createObjectURL(new Blob([linked], { type: "text/javascript" })));
    }
    return addresses.get(name);
  };
  return { main: addressOf("main.js"), release: () => [...addresses.values()].forEach(URL.revokeObjectURL) };
}

/** Make the picture that is shown until the page has one, also in a notebook without a kernel. */
function makeCover(model) {
  const cover = document.createElement("div");
  cover.style.cssText = "position:absolute; inset:0; background:#202124; pointer-events:none";
  const picture = model.get("_picture");
  if (picture?.byteLength) {
    const image = document.createElement("img");
    image.alt = "Last picture of the viewer";
    image.style.cssText = "width:100%; height:100%; margin:0; object-fit:contain";
    image.src = URL.createObjectURL(new Blob([copied(picture)], { type: "image/png" }));
    image.onload = image.onerror = () => URL.revokeObjectURL(image.src);
    cover.append(image);
  }
  const note = document.createElement("div");
  note.textContent = WAITING;
  note.style.cssText =
    "position:absolute; top:12px; left:12px; padding:3px 8px; border-radius:4px; font:12px/1.5 system-ui,sans-serif;" +
    "color:#d8d9dc; background:rgb(30 31 34 / 88%)";
  cover.append(note);
  return cover;
}

function render({ model, el }) {
  const { main, release } = loadable();
  const frame = document.createElement("iframe");
  const cover = makeCover(model);
  let socket = null;

  // A frame that the notebook moves loads its page again, which then opens another socket.
  const openSocket = () => {
    socket?.close();
    socket = new CommSocket(model);
    return socket;
  };
  frame.pointray = { openSocket, shown: () => cover.remove() };
  frame.title = "pointray";
  frame.style.cssText = "display:block; width:100%; height:100%; border:0";
  frame.srcdoc = PAGE.html.replace("</head>", `<script type="module" src="${main}"></script></head>`);

  const lost = () => socket?.lose(); // Jupyter: the kernel was restarted, or the connection to it was lost
  model.on("comm_live_update", lost);
  const box = document.createElement("div");
  box.className = "pointray-viewer";
  box.style.cssText = `position:relative; width:100%; height:${Number(model.get("_height")) || 600}px; overflow:hidden`;
  box.append(frame, cover);
  el.append(box);
  return () => {
    model.off("comm_live_update", lost);
    socket?.close();
    box.remove();
    release();
  };
}

export default { render };
