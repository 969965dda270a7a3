/** Overlays on the image: statistics, progress, toasts, legend, banner. */

const TOAST_TIME = 6000; // ms
const MOST_TOASTS = 5;

const byId = (id) => document.getElementById(id);

/** Show the statistics in the lower left corner. */
export function showStatus(lines) {
  byId("status").textContent = Array.isArray(lines) ? lines.join("\n") : "";
}

/** Show the server's progress: share 0..1 and seconds left (null if unknown); an empty stage hides it. */
export function showProgress(stage, share, seconds) {
  const known = Number.isFinite(share);
  const percent = Math.round(100 * Math.min(1, Math.max(0, known ? share : 1)));
  const [bar, text] = byId("progress").children;
  byId("progress").hidden = !stage;
  bar.classList.toggle("unknown", !known);
  bar.style.width = `${percent}%`;
  const left = Number.isFinite(seconds) ? `, ${timeLeft(seconds)} left` : "";
  text.textContent = known ? `${stage}, ${percent} %${left}` : `${stage} …`;
}

/** Format a duration in seconds. */
function timeLeft(seconds) {
  return seconds < 90 ? `${Math.max(1, Math.round(seconds))} s` : `${Math.round(seconds / 60)} min`;
}

/** Show a message for a while, or permanently; a repetition replaces the earlier one. */
export function showToast({ level = "info", text, stay = false }) {
  if (!text) return;
  const toasts = byId("toasts");
  const again = [...toasts.children].find((toast) => toast.dataset.text === String(text));
  again?.remove();
  const toast = document.createElement("div");
  toast.className = `toast ${level}`;
  toast.dataset.text = text;
  toast.append(String(text), closeButton(() => toast.remove()));
  toasts.append(toast);
  while (toasts.childElementCount > MOST_TOASTS) toasts.firstElementChild.remove();
  if (!stay) setTimeout(() => toast.remove(), TOAST_TIME);
}

/** Create the close button of a box. */
export function closeButton(close) {
  const button = document.createElement("button");
  button.className = "close";
  button.textContent = "×";
  button.ariaLabel = "Close";
  button.addEventListener("click", close);
  return button;
}

/** Show the legend of the colours (URL of an image); null hides it. */
export function showLegend(image) {
  const legend = byId("legend");
  legend.hidden = !image;
  if (image) legend.src = image;
  else legend.removeAttribute("src");
}

/** Bounds of the legend; null if hidden. */
export function legendBox() {
  const box = byId("legend").getBoundingClientRect();
  return box.width && box.height ? box : null;
}

/** Show the banner of a connection that is "lost" or "replaced"; an empty kind hides it. */
export function showBanner(kind) {
  byId("banner").hidden = kind !== "lost";
  byId("replaced").hidden = kind !== "replaced";
}

/** Hide or show the panel and all overlays. */
export function togglePlain() {
  document.body.classList.toggle("plain");
}
