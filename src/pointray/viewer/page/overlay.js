/** Texts over the picture: statistics, progress, toasts, legend, banner. */

const TOAST_TIME = 6000; // ms
const MOST_TOASTS = 5;

const byId = (id) => document.getElementById(id);

/** The statistics, lower left corner. */
export function showStatus(lines) {
  byId("status").textContent = Array.isArray(lines) ? lines.join("\n") : "";
}

/** What the server is busy with; share 0..1 and seconds left, null where they are not known; no stage: nothing. */
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

/** Seconds as people say them. */
function timeLeft(seconds) {
  return seconds < 90 ? `${Math.max(1, Math.round(seconds))} s` : `${Math.round(seconds / 60)} min`;
}

/** A message that goes after a while unless it is to stay; a second time the same one takes the first one's place. */
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

/** The small cross of a box. */
export function closeButton(close) {
  const button = document.createElement("button");
  button.className = "close";
  button.textContent = "×";
  button.ariaLabel = "Close";
  button.addEventListener("click", close);
  return button;
}

/** The legend of the colours, an image's URL, or null for none. */
export function showLegend(image) {
  const legend = byId("legend");
  legend.hidden = !image;
  if (image) legend.src = image;
  else legend.removeAttribute("src");
}

/** Where the legend stands, null while there is none. */
export function legendBox() {
  const box = byId("legend").getBoundingClientRect();
  return box.width && box.height ? box : null;
}

/** The banner of a lost connection. */
export function showBanner(shown) {
  byId("banner").hidden = !shown;
}

/** Hides or shows the panel and all texts, to see the picture alone. */
export function togglePlain() {
  document.body.classList.toggle("plain");
}
