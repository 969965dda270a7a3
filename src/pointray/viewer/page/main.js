/**
 * Page of pointray's viewer.
 *
 * The server holds the scene and renders; the page holds the camera and sends it when it has moved.
 */

import { copyCamera, isCamera, sameCamera } from "./camera.js";
import { Compass } from "./compass.js";
import { Connection, host } from "./connection.js";
import { closeHelp, prepareDialogs, saveFile, showCopy, toggleHelp } from "./dialogs.js";
import { Keys } from "./keys.js";
import { freeOf } from "./layout.js";
import { Markers } from "./markers.js";
import { Motion } from "./motion.js";
import * as overlay from "./overlay.js";
import { Panel } from "./panel.js";
import { Picture } from "./picture.js";
import { Pointer } from "./pointer.js";

const WIDEST = 3840; // device pixels
const TURN = Math.PI; // radians of orbit for a drag over the window's height
const LATENCIES = 1000; // latencies kept

const view = document.getElementById("view");
const motion = new Motion();
const markers = new Markers(() => send({ type: "clear" }));
const compass = new Compass();
const picture = new Picture(view, drawn);
const panel = new Panel(document.getElementById("panel"), send);

const sent = { camera: null, size: "" }; // last values sent to the server
const sun = { dx: 0, dy: 0 }; // not sent yet
let waiting = 0; // requested animation frame
let touched = 0; // ms, time of the first input since the last camera was sent

const report = { frames: 0, latency: [], timed: 0 };

const messages = {
  hello({ title }) {
    document.title = `${title} - pointray`;
    panel.setTitle(String(title));
  },
  place({ bounds, north }) {
    motion.setBounds(bounds);
    compass.setNorth(north);
  },
  camera: takeCamera,
  panel({ folders }) {
    panel.build(folders);
    sendSize(); // only now is it known what the panel covers
  },
  values: ({ values }) => panel.setValues(values),
  status: ({ lines }) => overlay.showStatus(lines),
  progress: ({ stage, share, seconds }) => overlay.showProgress(stage, share, seconds),
  toast: overlay.showToast,
  copy: showCopy,
  picked: (message) => markers.pick(message),
  measured: (message) => markers.measure(message),
  target: ({ position }) => act(() => motion.aim(position)),
  legend: ({ image }) => overlay.showLegend(image),
  frame: (header, payload) => picture.show(header, payload),
  file: saveFile,
};

/** Dispatch a message; unknown types, from a newer server, are ignored. */
function received(message, payload) {
  if (Object.hasOwn(messages, message?.type)) messages[message.type](message, payload);
}

/** Take a camera from the server. */
function takeCamera(message) {
  if (!isCamera(message)) return;
  if (message.animate && motion.camera) {
    motion.glide({ ...copyCamera(message), orthographic: motion.camera.orthographic });
  } else {
    motion.jump(message);
    sent.camera = motion.camera;
  }
  wake();
}

function opened() {
  sent.size = "";
  picture.restart();
  overlay.showBanner("");
  // Before the size: the server answers a size with its own camera until it has received one.
  sent.camera = null;
  sendCamera();
  sendSize();
}

/** Acknowledge each image, also one that was skipped, because the server waits for it. */
function drawn(header, shown) {
  send({ type: "seen", number: header.number });
  if (!shown) return;
  host?.shown();
  report.frames += 1;
  if (isCamera(header.camera)) {
    markers.follow(header.camera, picture.aspect);
    compass.follow(header.camera);
  }
  if (header.time > report.timed) measureLatency(header.time);
}

/** Measure the latency of a camera's first image; the refined ones repeat its time. */
function measureLatency(time) {
  report.timed = time;
  requestAnimationFrame(() => {
    report.latency.push(performance.now() - time);
    if (report.latency.length > LATENCIES) report.latency.shift();
  });
}

function send(message) {
  return connection.send(message);
}

/** Send the size of the view in device pixels, and the part that is not covered. */
function sendSize() {
  const { innerWidth, innerHeight, devicePixelRatio } = window;
  const ratio = Math.min(devicePixelRatio, WIDEST / innerWidth);
  const boxes = [panel.box, overlay.legendBox()].filter(Boolean);
  const free = freeOf({ width: innerWidth, height: innerHeight }, boxes).map((edge) => Math.round(edge * ratio));
  const size = { width: Math.round(innerWidth * ratio), height: Math.round(innerHeight * ratio), free };
  if (!panel.built || !(size.width > 0 && size.height > 0) || sent.size === JSON.stringify(size)) return;
  if (send({ type: "size", ...size })) sent.size = JSON.stringify(size);
}

function sendCamera() {
  if (!motion.camera || (sent.camera && sameCamera(sent.camera, motion.camera))) return;
  if (send({ type: "camera", ...motion.camera, time: touched || performance.now() })) sent.camera = motion.camera;
  touched = 0;
}

function sendSun() {
  if (sun.dx || sun.dy) send({ type: "sun", ...sun });
  sun.dx = sun.dy = 0;
}

/** Runs once per animation frame, only while something moves. */
function tick(now) {
  waiting = 0;
  if (motion.advance(now)) wake();
  sendSize();
  sendCamera();
  sendSun();
}

function wake() {
  waiting ||= requestAnimationFrame(tick);
}

/** Run an action whose result is sent in the next animation frame. */
function act(action) {
  touched ||= performance.now();
  action();
  wake();
}

const connection = new Connection({
  opened,
  closed: (replaced) => overlay.showBanner(replaced ? "replaced" : "lost"),
  received,
});

prepareDialogs();

new Pointer(view, {
  orbit: (dx, dy) => act(() => motion.orbit(-dx * TURN, dy * TURN)),
  pan: (dx, dy) => act(() => motion.pan(dx, dy)),
  dolly: (factor) => act(() => motion.dolly(factor)),
  sun: (dx, dy) => act(() => Object.assign(sun, { dx: sun.dx + dx, dy: sun.dy + dy })),
  query: (x, y, extend) => send({ type: "pick", x, y, purpose: "query", extend }),
  target: (x, y) => send({ type: "pick", x, y, purpose: "target", extend: false }),
});

new Keys({
  hold: (keys) => act(() => motion.hold(keys)),
  view: (name) => send({ type: "view", name }),
  clear: () => closeHelp() || markers.clear(),
  help: toggleHelp,
  plain: overlay.togglePlain,
  project: () => act(() => motion.reproject()),
});

window.addEventListener("resize", () => {
  panel.resized();
  act(() => {
    markers.redraw();
    compass.redraw();
  });
});
view.addEventListener("pointerdown", () => panel.yield());

// The free part of the view changes with the panel and the legend.
const covering = new ResizeObserver(wake);
for (const id of ["panel", "legend"]) covering.observe(document.getElementById(id));

window.pointray = {
  camera: () => motion.camera && copyCamera(motion.camera),
  get frames() {
    return report.frames;
  },
  get last() {
    return picture.header;
  },
  get latency() {
    return report.latency;
  },
  get connected() {
    return connection.connected;
  },
};
